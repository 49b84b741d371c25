"""What is written: numbers that read back the same, files that are whole or not there."""

import json
import os
import secrets
from pathlib import Path
from typing import Any


def number(value: float) -> str:
    """The shortest digits that read back as the same number."""
    return repr(float(value)).removesuffix(".0")


def write(path: str | os.PathLike[str], contents: str | bytes) -> None:
    """Write a file; a reader sees the old file or the new one, never a part.

    Args:
        path: the file. A link keeps pointing where it points.
        contents: text is written as UTF-8.

    Raises:
        OSError: the file cannot be written.
    """
    data = contents.encode("utf-8") if isinstance(contents, str) else contents
    target = Path(path).resolve()
    if target.is_dir():
        raise IsADirectoryError(f"{path}: is a directory; expected a file name")
    if target.exists() and not target.is_file():  # a terminal, /dev/null: nothing to replace
        target.write_bytes(data)
        return
    part = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}")
    try:
        part.write_bytes(data)
        os.replace(part, target)
    except OSError as error:
        raise type(error)(f"{path}: cannot write ({error.strerror}); expected a place for a file") from None
    finally:
        part.unlink(missing_ok=True)


def to_json(content: dict[str, Any]) -> str:
    """Strict JSON, to be read by people too; no NaN."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)


def write_json(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    """Write strict JSON, whole or not at all.

    Args:
        path: the file.
        content: only what JSON knows; no NaN.

    Raises:
        OSError: the file cannot be written.
    """
    write(path, to_json(content) + "\n")
