"""What is said of bad input: one line, in the words of those who gave it."""

import re

_OF_OPTIONS = {
    "expected column= one of": "expected --column with one of",
    "expected geometry= one of": "expected --geometry with one of",
    "no geometry= beside": "no --geometry beside",
    "expected white= (and dark=)": "expected --white (and --dark)",
    "expected white= as well": "expected --white as well",
    "expected no reflectance_unit beside": "expected no --reflectance-unit beside",
    "reflectance_unit beside a white": "--reflectance-unit beside a white",
    "or reflectance_unit='fraction' or 'percent'": "or --reflectance-unit fraction or percent",
    "expected reflectance_unit='fraction' or 'percent'": "expected --reflectance-unit fraction or percent",
    "expected standard_uncertainty=": "expected --uncertainty",
    "or partial=True for": "or --partial for",
    "say free.angle()": "say --free angle",
    "vcavity_jax.materials.names() lists": "'vcavity materials' lists",
}
_OF_CONFIG = {
    "expected column= one of": "expected column = one of",
    "expected geometry= one of": "expected geometry = one of",
    "no geometry= beside": "no geometry beside",
    "expected reflectance_unit='fraction' or 'percent'": "expected reflectance_unit = fraction or percent",
    "standard_uncertainty=": "uncertainty in [fit]",
    "say free.angle()": "say [parameters.angle]",
    "vcavity_jax.materials.names() lists": "'vcavity materials' lists",
}


def one_line(message: str) -> str:
    """A message on one line, whatever a file name or a library put into it."""
    return " ".join(message.split())


def described(error: OSError | ValueError) -> str:
    """The message of an error; those of the operating system come with a file and a reason."""
    if isinstance(error, OSError) and error.strerror:
        return f"{'output' if error.filename is None else error.filename}: {error.strerror}"
    return str(error) or type(error).__name__


def in_options(message: str) -> str:
    """A message of the library in the words of the command line."""
    for theirs, ours in _OF_OPTIONS.items():
        message = message.replace(theirs, ours)
    return re.sub(r"expected reflectance_unit='(\w+)'", r"expected --reflectance-unit \1", message)


def in_config(message: str) -> str:
    """A message of the library in the words of a config file."""
    for theirs, ours in _OF_CONFIG.items():
        message = message.replace(theirs, ours)
    return re.sub(r"expected reflectance_unit='(\w+)'", r'expected reflectance_unit = "\1"', message)
