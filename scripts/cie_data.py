"""Write the tables of vcavity_jax/data/cie from those of colour-science.

    python scripts/cie_data.py           write them
    python scripts/cie_data.py --check   exit with 1 if a file differs from what would be written

Observers come at 1 nm. Illuminants keep the steps of 5 nm at which the CIE tabulates them; between these,
linear interpolation is the CIE's own rule. Nothing is rounded.
"""

import argparse
import sys
from pathlib import Path

import colour

FOLDER = Path(__file__).resolve().parents[1] / "vcavity_jax" / "data" / "cie"
OBSERVERS = {
    "CIE 1931": "CIE 1931 2 Degree Standard Observer",
    "CIE 1964": "CIE 1964 10 Degree Standard Observer",
}
ILLUMINANTS = (
    *("A", "C", "D50", "D55", "D65", "D75", "E"),
    *(f"FL{i}" for i in range(1, 13)),
    *(f"FL3.{i}" for i in range(1, 16)),
    *("LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2"),
)


def number(value: float) -> str:
    """Digits that read back as the same number."""
    return repr(float(value)).removesuffix(".0")


def table(header: str, wavelengths: list[float], rows: list[list[float]]) -> str:
    """A CSV table; every number reads back as it was."""
    numbers = [[nm, *row] for nm, row in zip(wavelengths, rows, strict=True)]
    lines = [",".join(map(number, row)) for row in numbers]
    return "\n".join([header, *lines]) + "\n"


def tables() -> dict[str, str]:
    """Contents of all files, by name."""
    files = {}
    for name, known in OBSERVERS.items():
        functions = colour.MSDS_CMFS[known]
        header = "wavelength_nm,x,y,z"
        files[f"{name.replace(' ', '-')}.csv"] = table(
            header, functions.wavelengths.tolist(), functions.values.tolist()
        )
    # One table: empty where an illuminant is not tabulated.
    columns = [
        dict(zip(s.wavelengths, s.values, strict=True)) for s in map(colour.SDS_ILLUMINANTS.get, ILLUMINANTS)
    ]
    lines = [",".join(["wavelength_nm", *ILLUMINANTS])]
    for nm in sorted(set().union(*columns)):
        lines.append(",".join([number(nm), *(number(c[nm]) if nm in c else "" for c in columns)]))
    files["illuminants.csv"] = "\n".join(lines) + "\n"
    return files


def main() -> int:
    """Write or check the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    check = parser.parse_args().check
    status = 0
    for name, contents in tables().items():
        path = FOLDER / name
        if not check:
            path.write_text(contents, encoding="utf-8")
        elif not path.exists() or path.read_text(encoding="utf-8") != contents:
            print(f"{path}: differs from what scripts/cie_data.py writes", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
