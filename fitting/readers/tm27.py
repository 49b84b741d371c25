"""IES TM-27-14: one spectrum as XML, read by colour-science."""

import os
import tempfile
import warnings
from typing import Any

import numpy as np

from fitting.readers import geometry, xml
from fitting.readers.samples import Sample, SampleFile

_DECLARED = {
    "reflectance": "fraction",
    "transmittance": "fraction",
    "r-factor": "fraction",
    "t-factor": "fraction",
}


def read(path: str, root: Any, data: bytes, quantity: str) -> SampleFile:
    """The spectrum of a file.

    Args:
        path: for messages.
        root: of the document, which was found harmless.
        data: the file.
        quantity: "reflectance" or "transmittance".

    Raises:
        ValueError: the file breaks the format or holds another quantity.
    """
    stated = xml.text(root, "SpectralQuantity").lower()
    if stated and quantity not in stated and not (quantity[0] == stated[0] and stated.endswith("-factor")):
        raise ValueError(f"{path}: SpectralQuantity is {stated}; expected {quantity}")
    rows = [one for one in root.iter() if xml.local(one) == "SpectralData"]
    if not rows:
        raise ValueError(f"{path}: no SpectralData; expected at least one")
    distribution = _parsed(path, data)
    said = xml.text(root, "ReflectionGeometry")
    specular = {"true": "excluded"}.get(xml.text(root, "SpecularExcluded").lower(), "")
    names = geometry.understood(said, specular) if said.lower() not in ("", "other") else ()
    kept = {key: xml.text(root, name) for key, name in (("title", "Description"), ("instrument", "Manufacturer"))}
    sample = Sample(
        "",
        np.array(distribution.wavelengths, dtype=np.float64),
        np.array([distribution.values], dtype=np.float64),
        path,
        unit=_DECLARED.get(stated),
        geometries=names,
        said="" if said.lower() == "other" else said,
    )
    return SampleFile(path, [sample], {key: value for key, value in kept.items() if value})


def _parsed(path: str, data: bytes) -> Any:
    """By colour-science, which reads files only."""
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")
        import colour

        copy = os.path.join(folder, "spectrum.spdx")
        with open(copy, "wb") as stream:
            stream.write(data)
        try:
            return colour.SpectralDistribution_IESTM2714(copy).read()
        except (AttributeError, AssertionError, KeyError, TypeError, ValueError) as error:
            what = " ".join(str(error).split())[:100]
            raise ValueError(f"{path}: not as TM-27 has it ({what}); expected wavelengths and numbers") from None
