"""The project as a whole: the public names, one version everywhere, sound pins, nothing left behind."""

import ast
import importlib.util
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

import fitting
import vcavity_jax

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def git_files(*options: str) -> list[Path]:
    """Files by git's account; outside a checkout (say, a source distribution) there is none."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    try:
        listing = subprocess.run(
            ["git", "ls-files", "-z", *options], cwd=ROOT, check=True, capture_output=True, text=True
        ).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"git cannot list the files: {error}")
    return [ROOT / name for name in listing.split("\0") if name]


def entry(file: str, pattern: str) -> str:
    """The first match of a pattern's group in a file."""
    match = re.search(pattern, (ROOT / file).read_text(), re.MULTILINE)
    assert match, f"{file} has no {pattern!r}"
    return match.group(1)


def imported_packages(path: Path) -> set[str]:
    """The top-level packages that a file imports, anywhere in it."""
    packages = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            packages |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            packages.add(node.module.partition(".")[0])
    return packages


@pytest.mark.parametrize(
    "name",
    [
        *["Scene", "VGrooves", "BeckmannGrooves"],
        *["Specular", "Lambertian", "TwoPanels"],
        *["Diffuse", "Directional", "Mixed", "View"],
        *["reflectance_factor", "radiance_profile", "materials"],
    ],
)
def test_vcavity_jax_has_public_name(name):
    assert hasattr(vcavity_jax, name)


@pytest.mark.parametrize("name", ["Measurement", "fit", "free", "FitResult"])
def test_fitting_has_public_name(name):
    assert hasattr(fitting, name)


def test_one_version():
    version = PROJECT["project"]["version"]
    assert vcavity_jax.__version__ == version
    assert entry("CITATION.cff", r"^version: (\S+)$") == version
    assert entry("CHANGELOG.md", r"^## \[(\d[^\]]*)\]") == version


def test_one_release_date():
    assert entry("CITATION.cff", r"^date-released: (\S+)$") == entry("CHANGELOG.md", r"^## \[\d.*\] - (\S+)$")


def test_one_license():
    license = PROJECT["project"]["license"]
    assert license == entry("CITATION.cff", r"^license: (\S+)$") == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text()


def test_physics_does_not_import_fitting():
    files = list((ROOT / "vcavity_jax").rglob("*.py"))
    assert files
    assert [file.name for file in files if "fitting" in imported_packages(file)] == []


def test_no_file_names_a_package_index_or_a_machine():
    private = re.compile(r"https?://\S*(?:pypi|pythonhosted)|(?<![\w.-])/(?:work|root)/")
    found = []
    for path in git_files("--cached", "--others", "--exclude-standard"):
        try:
            text = path.read_text(encoding="utf-8")
        except (UnicodeDecodeError, FileNotFoundError):  # a picture; a file that is about to be removed
            continue
        found += [f"{path.relative_to(ROOT)}: {match}" for match in private.findall(text)]
    assert found == []


def test_pins_agree():
    path = ROOT / "scripts" / "pin.py"
    if not path.exists():
        git_files()  # skips outside a checkout
    specification = importlib.util.spec_from_file_location("pin", path)
    pin = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(pin)
    assert pin.disagreements() == []


def test_lock_is_not_tracked():
    assert git_files("--cached", "uv.lock") == []


def test_the_gallery_shows_every_script_of_the_portfolio():
    folder = ROOT / "docs" / "portfolio"
    page = (folder / "gallery.md").read_text()
    scripts = sorted((ROOT / "examples" / "portfolio").glob("pf*.py"))
    assert len(scripts) == 24
    for script in scripts:
        assert f"examples/portfolio/{script.name})" in page
    shown = re.findall(r"^!\[.*\]\((.*\.png)\)$", page, re.MULTILINE)
    assert len(shown) == 25
    assert {path.name for path in folder.glob("*.png")} == set(shown)
