"""Files are whole or not there, whoever writes them."""

import os
from pathlib import Path

import pytest

from fitting import files


@pytest.mark.parametrize(("contents", "stored"), [("Δ\n", b"\xce\x94\n"), (b"\x00\n", b"\x00\n")])
def test_text_and_bytes_are_stored_as_they_are(tmp_path: Path, contents: str | bytes, stored: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    files.write(path, contents)
    assert path.read_bytes() == stored
    assert list(tmp_path.iterdir()) == [path]


def test_links_are_followed_and_devices_left_alone(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to(target)
    files.write(link, "text")
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "text"
    files.write(os.devnull, "text")
    assert not Path(os.devnull).is_file()


def test_failure_keeps_the_old_file_and_its_kind_of_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone.file: cannot write \(No such file or directory\)"):
        files.write(tmp_path / "gone" / "file", "text")
    with pytest.raises(IsADirectoryError, match="is a directory; expected a file name"):
        files.write(tmp_path, "text")
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match=r"cannot write \(No space left on device\)"):
        files.write(path, "new")
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"old"]


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e-300, -0.0, 450.0])
def test_numbers_read_back_the_same(value: float) -> None:
    assert float(files.number(value)) == value
    assert files.number(450.0) == "450"
