"""XML from anywhere, read without harm."""

from typing import Any


def parse(path: str, data: bytes) -> Any:
    """The root of a document, as an element of ``xml.etree``.

    Raises:
        ValueError: it is not well formed, or declares entities or a document type, which can name other files or
            grow without bound.
    """
    from xml.etree.ElementTree import ParseError

    from defusedxml import DefusedXmlException, ElementTree

    try:
        return ElementTree.fromstring(data, forbid_dtd=True)
    except ParseError as error:
        what = str(error).split(":")[0]
        raise ValueError(
            f"{path}:{error.position[0]}: not well-formed XML ({what}); expected a whole file"
        ) from None
    except DefusedXmlException:
        raise ValueError(f"{path}:1: the file declares a document type or entities; expected plain XML") from None
    except (LookupError, ValueError) as error:
        raise ValueError(f"{path}:1: cannot be decoded ({error}); expected UTF-8") from None


def local(element: Any) -> str:
    """The name without its namespace."""
    return str(element.tag).rpartition("}")[2]


def first(element: Any, name: str) -> Any:
    """The first descendant of this name, None if there is none."""
    return next((one for one in element.iter() if local(one) == name), None)


def text(element: Any, name: str) -> str:
    """The text of the first descendant of this name, "" if there is none."""
    found = first(element, name)
    return "" if found is None or found.text is None else str(found.text).strip()
