"""All figures of the portfolio, and the page of the gallery.

    python examples/portfolio/gallery.py [OUTDIR]

writes a picture for each figure of the thesis's portfolio and gallery.md, which lists what the thesis says of each
and what comes out here, into OUTDIR (a new temporary folder by default). The page in docs/ is made by

    python examples/portfolio/gallery.py docs/portfolio
"""

import argparse
import importlib
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from common import Claim, Plate

from fitting import files

INTRODUCTION = """# Gallery: the thesis's portfolio, redrawn

The portfolio of [SaintPierre2020] shows 24 figures. Its measured spectra are not published, so measured patches
of a color chart stand for its inks and papers (`examples/data`), and tables of refractiveindex.info for its
metals. Beside each figure: what the thesis says of it, what comes out here, and whether that bears it out.
*Open* means that it depends on spectra which are not published. Colors are those of D65 and the 2° observer
unless said otherwise, relative to the perfect diffuser.

`python examples/portfolio/gallery.py docs/portfolio` makes this page, its pictures and every number on it; each
script draws one figure, as `python examples/portfolio/pf3_06.py`.
"""


def plates() -> list[tuple[str, Plate]]:
    """Of every script, in the order of the thesis."""
    scripts = sorted(path.stem for path in Path(__file__).parent.glob("pf*.py"))
    after = scripts.index("pf3_13")
    return [
        (name, importlib.import_module(name).PLATE) for name in [*scripts[:after], "threshold", *scripts[after:]]
    ]


def section(script: str, plate: Plate, claims: Sequence[Claim]) -> str:
    """Of the page."""
    rows = [f"| {one.thesis} | {one.ours} | {one.verdict} |" for one in claims]
    lines = [
        f"## {plate.name}: {plate.title}",
        "",
        f"![{plate.title}]({plate.file})",
        "",
        f"[examples/portfolio/{script}.py](../../examples/portfolio/{script}.py)",
        "",
        "| the thesis says | here | borne out |",
        "|---|---|---|",
        *rows,
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Draw everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path)
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp())
    sections, verdicts = [], []
    for script, plate in plates():
        start = time.perf_counter()
        claims = plate.write(outdir)
        sections.append(section(script, plate, claims))
        verdicts += [one.holds for one in claims]
        print(f"{plate.name}: {plate.file}, {time.perf_counter() - start:.1f} s", flush=True)
    count = (
        f"Of {len(verdicts)} statements, {verdicts.count(True)} are borne out, {verdicts.count(False)} are not, "
        f"and {verdicts.count(None)} are open.\n"
    )
    files.write(outdir / "gallery.md", "\n".join([INTRODUCTION, count, *sections]).encode())
    print(f"{count}wrote {outdir / 'gallery.md'}")


if __name__ == "__main__":
    main()
