"""`vcavity bench`: speed against error, measured here."""

import argparse
import sys
from pathlib import Path

import jax

from fitting.bench import report
from fitting.bench.measure import FULL, Effort
from fitting.cli.fit import require_writable


def run(given: argparse.Namespace) -> int:
    """Measure, print the table and write what was found; each row is told on standard error as it comes."""
    if given.output is not None:
        require_writable(Path(given.output).parent)
    jax.config.update("jax_enable_compilation_cache", False)  # compiling is measured, too
    machines, machine = report.find_machines()
    parts = tuple(dict.fromkeys(given.part or report.PARTS))
    found = report.run(
        parts,
        FULL if given.full else Effort(),
        machines,
        lambda text: print(text, file=sys.stderr, flush=True),
        tuple(dict.fromkeys(given.peer)),
    )
    print(report.markdown(found, machine))
    if given.output is not None:
        for path in report.write(found, machine, Path(given.output)):
            print(f"wrote {path}")
    return 0
