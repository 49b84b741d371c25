"""`vcavity fit`: from a measurement to the groove's parameters."""

import argparse
import os
import sys
from pathlib import Path

from fitting import FitResult, Measurement, files, fit
from fitting.cli import arguments, messages, request
from fitting.comparison import Comparison, compare_with_rivals


def run(given: argparse.Namespace) -> int:
    """Fit, print the answer, write fit.json and fit.png; 0 if the answer can be trusted, else 1."""
    if given.config is None:
        asked = request.of_options(given)
    else:
        from fitting.cli import config

        _refuse_beside_config(given)
        asked = config.read(given.config, given.measurement)
    folder = asked.folder if given.output is None else Path(given.output)
    _require_writable(folder)
    if given.compare:
        _require_one(asked)
    tolerance = {} if given.tolerance is None else {"tolerance": given.tolerance}
    options = {"tolerance": arguments.TOLERANCE} | asked.options | tolerance

    try:
        result = fit(asked.scene, asked.measurement, asked.parameters, **options)
    except ValueError as error:
        raise ValueError(asked.explained(str(error))) from None
    comparison = _compared(asked, result) if given.compare else None

    folder.mkdir(parents=True, exist_ok=True)
    written = folder / "fit.json", folder / "fit.png"
    compared = {} if comparison is None else {"comparison": comparison.to_dict()}
    files.write_json(written[0], result.to_dict() | compared)
    result.plot(written[1])
    if given.json:
        print(written[0].read_text(encoding="utf-8").rstrip("\n"))
    else:
        print(result.summary())
        if comparison is not None:
            print("", comparison.summary(), "", sep="\n")
        print(*(f"wrote {path}" for path in written), sep="\n")
    trusted = result.status == "converged" and result.identifiable
    if not trusted or result.describes_data is False:
        sys.stdout.flush()
        print(f"vcavity: {result.status}: {messages.one_line(result.message)}", file=sys.stderr)
    return 0 if trusted else 1


def _require_one(asked: request.Request) -> None:
    """Refuse to compare models of several measurements, before anything is fitted."""
    if not isinstance(asked.measurement, Measurement):
        raise ValueError("--compare with several measurements; expected one, whose model has rivals")


def _compared(asked: request.Request, result: FitResult) -> Comparison:
    """The fit beside those of its rivals."""
    steps = {"max_steps": asked.options["max_steps"]} if "max_steps" in asked.options else {}
    try:
        return compare_with_rivals(result, **steps)
    except ValueError as error:
        raise ValueError(f"--compare: {asked.explained(str(error))}") from None


def _refuse_beside_config(given: argparse.Namespace) -> None:
    """Refuse the options that a config file stands for."""
    allowed = {"command", "config", "measurement", "output", "json", "compare", "tolerance"}
    for name, value in vars(given).items():
        if name not in allowed and value is not None and value is not False and value != []:
            raise ValueError(
                f"--{name.replace('_', '-')} beside --config {given.config}: expected it in the file; only "
                "--output, --json, --compare and --tolerance may stand beside --config"
            )


def _require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written, before the fit and without leaving anything behind."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise NotADirectoryError(f"{existing}: is a file; expected a folder for the output")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise PermissionError(f"{existing}: no permission to write; expected a folder for the output")
