"""What the documents show works: Python examples run, commands parse, files read, links lead somewhere."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, assembly, free
from fitting.cli import arguments

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [Path("README.md"), *sorted(path.relative_to(ROOT) for path in (ROOT / "docs").glob("*.md"))]


def text(document: Path) -> str:
    """A document without what its comments hide."""
    return re.sub(r"<!--.*?-->", "", (ROOT / document).read_text(encoding="utf-8"), flags=re.DOTALL)


def blocks(document: Path, language: str) -> list[str]:
    """The fenced blocks in a language, each on the lines that it has in the document."""
    content = (ROOT / document).read_text(encoding="utf-8")
    found = re.finditer(rf"^```{language}\n(.*?)^```$", content, flags=re.DOTALL | re.MULTILINE)
    return ["\n" * content.count("\n", 0, match.start(1)) + match[1] for match in found]


def commands(document: Path) -> list[list[str]]:
    """The words after each `vcavity` in the shell blocks."""
    lines = "\n".join(blocks(document, "sh")).replace("\\\n", " ").splitlines()
    found = [re.search(r"(?:^|uv run )vcavity (.*)", line) for line in lines]
    return [shlex.split(match[1]) for match in found if match]


def anchors(document: Path) -> set[str]:
    """The places in a document that a link can point to."""
    headings = re.findall(r"^#+ (.*)$", text(document), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", [Path("README.md"), Path("docs/fitting.md")], ids=str)
def test_python_examples_run(document, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    examples = blocks(document, "python")
    assert examples
    shared: dict[str, object] = {"__name__": "example"}
    for example in examples:  # one after the other, as a reader would type them
        exec(compile(example, str(document), "exec"), shared)
    assert "converged" in capsys.readouterr().out
    truth = float(shared["measurement"].metadata["truth"].removeprefix("angle_deg = "))
    low, high = np.degrees(shared["result"].estimates["angle"].interval_95[0])
    assert low < truth < high


def test_parameters_of_the_documents_fit_together():
    """The examples of docs/parameters.md, made ready but not fitted."""
    nm, fan = np.array([450.0, 550.0, 650.0]), np.radians([-60.0, 0.0, 60.0])

    def seen(light):
        return Measurement(nm, fan, np.zeros(3), np.full((3, 3), 0.4), np.full((3, 3), 0.01), illumination=light)

    def scene(light):
        return vc.Scene(vc.VGrooves(1.0), vc.Lambertian(0.5), light, vc.View())

    directional = vc.Directional(0.5)
    shared: dict[str, object] = {
        "fit": lambda scenes, measurements, given: assembly.build(scenes, measurements, given, None, 1e-3),
        "free": free,
        "scene": scene(vc.Diffuse()),
        "measurement": seen(vc.Diffuse()),
        "scene_in_directional_light": scene(directional),
        "first": seen(vc.Diffuse()),
        "second": seen(directional),
    }
    made = []
    for example in blocks(Path("docs/parameters.md"), "python"):
        names = dict(shared)
        exec(compile(example, "docs/parameters.md", "exec"), names)
        made += [[p.name for p in names["result"].numbers]] if "result" in names else []
    assert made[0] == ["angle", "tilt_across", "tilt_along", "gain"]
    assert made[1] == ["angle", "gain[sphere]", "gain[gonio]", "offset[gonio]"]


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_commands_parse(document):
    for words in commands(document):
        if words[-1] != "--help":
            assert arguments.parser().parse_args(words)


def test_there_are_commands():
    assert len(commands(Path("README.md"))) >= 3
    assert len(commands(Path("docs/fitting.md"))) >= 1


def test_measurement_file_reads(tmp_path):
    (example,) = blocks(Path("docs/fitting.md"), "csv")
    path = tmp_path / "example.csv"
    path.write_text(example.lstrip(), encoding="utf-8")
    measurement = Measurement.read(path)
    assert measurement.reflectance_factor.shape == (2, 2)
    assert np.isnan(measurement.reflectance_factor[1, 1])


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_links_lead_somewhere(document):
    for link in re.findall(r"\]\(([^)\s]+)\)", text(document)):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = ROOT / document.parent / name if name else ROOT / document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target.resolve().relative_to(ROOT)), link
