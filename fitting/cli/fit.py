"""`vcavity fit`: from a measurement to the groove's parameters."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from fitting import FitResult, Measurement, files, fit, rivals
from fitting.cli import arguments, messages, request


def run(given: argparse.Namespace) -> int:
    """Fit, print the answer, write fit.json and fit.png; 0 if the answer can be trusted, else 1."""
    if given.config is None:
        asked = request.of_options(given)
    else:
        from fitting.cli import config

        _refuse_beside_config(given)
        asked = config.read(given.config, given.measurement)
    if not given.posterior and (given.sampler or given.seed):
        raise ValueError(f"--{'sampler' if given.sampler else 'seed'} has no effect: expected --posterior with it")
    folder = asked.folder if given.output is None else Path(given.output)
    require_writable(folder)
    models = _models(asked) if given.compare else None
    tolerance = {} if given.tolerance is None else {"tolerance": given.tolerance}
    options = {"tolerance": arguments.TOLERANCE} | asked.options | tolerance

    try:
        result = fit(asked.scene, asked.measurement, asked.parameters, **options)
    except ValueError as error:
        raise ValueError(asked.explained(str(error))) from None
    comparison = None if models is None else _compared(asked, models, options)

    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "fit.json", folder / "fit.png"]
    content = result.to_dict() | ({} if comparison is None else {"comparison": comparison.to_dict()})
    files.write_json(written[0], content)
    result.plot(written[1])
    posterior = None
    if given.posterior:
        posterior = _sampled(result, given, folder, written)
        files.write_json(written[0], content | {"posterior": posterior.to_dict()})
    if given.json:
        print(written[0].read_text(encoding="utf-8").rstrip("\n"))
    else:
        print(result.summary())
        if comparison is not None:
            print("", comparison.summary(), sep="\n")
        if posterior is not None:
            print("", posterior.summary(), sep="\n")
        print(*(f"wrote {path}" for path in written), sep="\n")
    trusted = result.status == "converged" and result.identifiable
    if not trusted or result.describes_data is False:
        sys.stdout.flush()
        print(f"vcavity: {result.status}: {messages.one_line(result.message)}", file=sys.stderr)
    return 0 if trusted else 1


def _sampled(result: FitResult, given: argparse.Namespace, folder: Path, written: list[Path]) -> Any:
    """Sample the posterior and write its pictures and draws."""
    from fitting import sample_posterior

    chain = folder / "chain.h5" if given.sampler == "emcee" else None
    posterior = sample_posterior(
        result, given.sampler, chain=chain, seed=given.seed or 1, progress=sys.stderr.isatty()
    )
    drawn = {"corner.png": posterior.corner, "predictive.png": posterior.predictive}
    if chain is not None:
        drawn["trace.png"] = posterior.trace
        written.append(chain)
    for name, draw in (drawn | {"posterior.nc": posterior.to_netcdf}).items():
        draw(folder / name)
        written.append(folder / name)
    return posterior


def _models(asked: request.Request) -> dict[str, Any]:
    """What the measurement is compared under; refused before anything is fitted."""
    if not isinstance(asked.measurement, Measurement):
        raise ValueError("--compare with several measurements; expected one, whose model has rivals")
    try:
        return rivals(asked.scene)
    except ValueError as error:
        raise ValueError(f"--compare: {asked.explained(str(error))}") from None


def _compared(asked: request.Request, models: dict[str, Any], options: dict[str, Any]) -> Any:
    """The model beside its rivals, see ``fitting.Comparison``."""
    from fitting import compare_models  # with all samplers, which a plain fit does not need

    try:
        return compare_models(models, asked.measurement, asked.parameters, **options)
    except ValueError as error:
        raise ValueError(f"--compare: {asked.explained(str(error))}") from None


def _refuse_beside_config(given: argparse.Namespace) -> None:
    """Refuse the options that a config file stands for."""
    allowed = {"command", "config", "measurement", "output", "json", "compare", "tolerance"}
    allowed |= {"posterior", "sampler", "seed"}
    for name, value in vars(given).items():
        if name not in allowed and value is not None and value is not False and value != []:
            raise ValueError(
                f"--{name.replace('_', '-')} beside --config {given.config}: expected it in the file; only "
                "--output, --json, --tolerance, --compare and --posterior with its options may stand beside it"
            )


def require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written, before the fit and without leaving anything behind."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise NotADirectoryError(f"{existing}: is a file; expected a folder for the output")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise PermissionError(f"{existing}: no permission to write; expected a folder for the output")
