"""What the commands write: numbers that read back the same, files that are whole or not there."""

import os
import secrets
from pathlib import Path


def number(value: float) -> str:
    """The shortest digits that read back as the same number."""
    return repr(float(value)).removesuffix(".0")


def write(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file; a reader sees the old file or the new one, never a part.

    Args:
        path: the file. A link keeps pointing where it points.
        text: its contents, written as UTF-8.

    Raises:
        OSError: the file cannot be written.
    """
    target = Path(path).resolve()
    if target.is_dir():
        raise IsADirectoryError(f"{path}: is a directory; expected a file name")
    if target.exists() and not target.is_file():  # a terminal, /dev/null: nothing to replace
        target.write_text(text, encoding="utf-8")
        return
    part = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        os.replace(part, target)
    except OSError as error:
        raise OSError(f"{path}: cannot write ({error.strerror}); expected a place for a file") from None
    finally:
        part.unlink(missing_ok=True)
