"""Which format a file has, told from what is in it and never from its name."""

from os import PathLike, fspath
from pathlib import Path

from fitting.readers import cgats, cxf, jcamp_dx, native, read_text, tm27, xml
from fitting.readers.contents import Contents
from fitting.readers.samples import Asked

_MAX_XML_BYTES = 32 * 1024 * 1024


def read(path: str | PathLike[str], asked: Asked) -> Contents:
    """Read a measurement: native CSV, two columns, CGATS, CxF3, JCAMP-DX or IES TM-27.

    Args:
        path: the file.
        asked: what the file may not say.

    Returns:
        The checked contents; reflectance as a fraction, angles in radians.

    Raises:
        OSError: the file is missing, a directory or not readable.
        ValueError: the file breaks its format, does not say what must be known, or contradicts what was asked.
    """
    name, file = fspath(path), Path(path)
    begin = ""
    if file.is_file():
        with file.open("rb") as stream:
            begin = stream.read(1 << 20).decode("latin-1").removeprefix("\xef\xbb\xbf")
        begin = begin.replace("\r", "\n").lstrip()
    if begin.startswith("<"):
        return _of_xml(name, file, asked)
    if cgats.found_in(begin):
        return cgats.read(name, read_text(path, latin=True)).contents(asked)
    if jcamp_dx.found_in(begin):
        return jcamp_dx.read(name, read_text(path, latin=True), asked.quantity).contents(asked)
    return native.read(path, asked)


def _of_xml(name: str, file: Path, asked: Asked) -> Contents:
    if file.stat().st_size > _MAX_XML_BYTES:
        raise ValueError(f"{name}:1: XML larger than {_MAX_XML_BYTES >> 20} MB; expected a measurement")
    data = file.read_bytes()
    root = xml.parse(name, data)
    kind = xml.local(root)
    if kind == "CxF":
        return cxf.read(name, root, asked.quantity).contents(asked)
    if kind.upper().startswith("IESTM27"):
        return tm27.read(name, root, data, asked.quantity).contents(asked)
    raise ValueError(f"{name}:1: XML of the kind {kind[:40]!r}; expected CxF or IESTM2714")
