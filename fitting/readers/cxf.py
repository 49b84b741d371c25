"""CxF3, the Color Exchange Format [ISO 17972-1], also where a file is not quite as the schema has it."""

from collections import Counter
from typing import Any

import numpy as np

from fitting.readers import geometry, number, quoted, xml
from fitting.readers.samples import Sample, SampleFile

_SPECTRA = {"reflectance": "ReflectanceSpectrum", "transmittance": "TransmittanceSpectrum"}
_SPHERES = {"specular_included": ("di:8",), "specular_excluded": ("de:8",)}


def read(path: str, root: Any, quantity: str) -> SampleFile:
    """All spectra of the objects in a file.

    Args:
        path: for messages.
        root: of the document.
        quantity: "reflectance" or "transmittance".

    Raises:
        ValueError: there is no spectrum, or one without wavelengths or with something else than numbers.
    """
    specifications = {
        one.get("Id", ""): one for one in root.iter() if xml.local(one) == "ColorSpecification" and len(one)
    }
    found: list[tuple[str, str, Any, Any]] = []
    for thing in root.iter():
        if xml.local(thing) != "Object":
            continue
        spectra = [one for one in thing.iter() if xml.local(one) == _SPECTRA[quantity]]
        for spectrum in spectra:
            by = spectrum.get("ColorSpecification", "")
            name = thing.get("Name") or thing.get("Id") or str(len(found) + 1)
            if len(spectra) > 1:
                name = f"{name} [{by or spectra.index(spectrum) + 1}]"
            found.append((name, thing.get("Id", ""), spectrum, specifications.get(by)))
    if not found:
        raise ValueError(f"{path}:1: no {_SPECTRA[quantity]} in any object; expected at least one")
    twice = Counter(name for name, *_ in found)
    samples = [
        _sample(path, f"{name} ({identity})" if twice[name] > 1 and identity else name, spectrum, specification)
        for name, identity, spectrum, specification in found
    ]
    information = next((one for one in root if xml.local(one) == "FileInformation"), None)
    kept = {} if information is None else {xml.local(one).lower(): (one.text or "").strip() for one in information}
    return SampleFile(path, samples, {key: value for key, value in kept.items() if value})


def _sample(path: str, name: str, spectrum: Any, specification: Any) -> Sample:
    where = f"{path}: object {quoted(name)}"
    values = []
    for word in (spectrum.text or "").replace(";", " ").split():
        value = number(word.replace(",", "."))
        if value is None:
            raise ValueError(f"{where}: {quoted(word)} in its spectrum; expected numbers")
        values.append(value)
    if not values:
        raise ValueError(f"{where}: its spectrum is empty; expected numbers")
    span = None if specification is None else xml.first(specification, "WavelengthRange")
    stated = {} if span is None else dict(span.attrib)
    stated.update(spectrum.attrib)
    start, step = (_number(where, stated, key) for key in ("StartWL", "Increment"))
    if start is None or step is None:
        missing = "StartWL" if start is None else "Increment"
        raise ValueError(f"{where}: no {missing}; expected it in the WavelengthRange of its ColorSpecification")
    names, said = ((), "") if specification is None else _geometry(specification)
    return Sample(
        name,
        start + step * np.arange(len(values)),
        np.array([values]),
        where,
        unit="fraction",
        geometries=names,
        said=said,
    )


def _number(where: str, stated: dict[str, str], key: str) -> float | None:
    if key not in stated:
        return None
    value = number(stated[key].replace(",", "."))
    if value is None or not 0 < value < 1e5:
        raise ValueError(f"{where}: {key} is {quoted(stated[key])}; expected nanometers")
    return value


def _geometry(specification: Any) -> tuple[tuple[str, ...], str]:
    """Names that agree with the specification, and its words."""
    sphere = xml.text(specification, "SphereGeometry")
    if sphere:
        return _SPHERES.get(sphere.lower(), ("di:8", "de:8", "d:8", "d:0")), sphere
    single = xml.first(specification, "SingleAngle")
    if single is None:
        multi = xml.first(specification, "MultiAngle")
        return (), "" if multi is None else "MultiAngle"
    ends = [xml.text(single, name).removesuffix(".0") for name in ("IlluminationAngle", "MeasurementAngle")]
    kind = xml.text(single, "SingleAngleConfiguration")
    said = f"{':'.join(ends)} {kind}".strip()
    return geometry.understood(":".join(ends), configuration=kind.lower()), said
