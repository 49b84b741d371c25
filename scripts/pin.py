"""Pin every dependency to an exact version.

    python scripts/pin.py             pin what is new, keep the versions already pinned
    python scripts/pin.py --upgrade   take the newest versions of everything
    python scripts/pin.py --check     exit with 1 if the pins disagree (needs no network)

The pins stand in three places: `constraint-dependencies` in pyproject.toml, which `uv sync` and `uv run`
obey and which cover every extra and the development tools; and, for pip, the hash-locked requirements.txt
and requirements-dev.txt (the same plus the development tools).
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RUNTIME, DEVELOPMENT = "requirements.txt", "requirements-dev.txt"

CONSTRAINTS = re.compile(r"^constraint-dependencies = \[\n.*?^\]\n", re.MULTILINE | re.DOTALL)
LOCATION = re.compile(r"http|index-url|find-links|file:")
PIN = re.compile(r"(?P<name>[a-z0-9-]+)==(?P<version>[^\s;]+)")


def pins(lines: list[str]) -> set[tuple[str, str]]:
    """The (name, version) pairs of requirement lines."""
    return {match.group("name", "version") for line in lines if (match := PIN.match(line))}


def constraints(pyproject: str) -> list[str]:
    """The constraints that pyproject.toml holds now."""
    return tomllib.loads(pyproject).get("tool", {}).get("uv", {}).get("constraint-dependencies", [])


def with_constraints(pyproject: str, requirements: list[str]) -> str:
    """The text of pyproject.toml with its list of constraints replaced and the rest untouched."""
    table = "".join(f'    "{requirement}",\n' for requirement in requirements)
    table = f"constraint-dependencies = [\n{table}]\n"
    if CONSTRAINTS.search(pyproject):
        text = CONSTRAINTS.sub(lambda _: table, pyproject)
    elif "\n[tool.uv]\n" in pyproject:
        text = pyproject.replace("\n[tool.uv]\n", f"\n[tool.uv]\n{table}")
    else:
        text = f"{pyproject}\n[tool.uv]\n{table}"
    if constraints(text) != requirements:
        raise SystemExit("pyproject.toml: cannot find where the list of constraints belongs")
    return text


def without_needless_markers(requirements: list[str]) -> list[str]:
    """Requirements by name, where only packages pinned to several versions keep their markers."""
    names = [requirement.partition("==")[0] for requirement in requirements]
    return [
        requirement if names.count(name) > 1 else requirement.partition(" ;")[0]
        for name, requirement in sorted(zip(names, requirements, strict=True))
    ]


def resolve(pyproject: str) -> tuple[list[str], str, str]:
    """The constraints and the two requirement files that uv finds for a pyproject.toml."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "pyproject.toml").write_text(pyproject)

        def uv(*arguments: str) -> str:
            command = ["uv", *arguments, "--quiet", "--project", folder]
            return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout

        def export(*arguments: str) -> str:
            plain = ["--frozen", "--no-emit-project", "--no-header", "--no-annotate"]
            return uv("export", *plain, *arguments)

        uv("lock")
        everything = export("--all-extras", "--all-groups", "--no-hashes").splitlines()
        return without_needless_markers(everything), export("--no-dev"), export()


def write(name: str, text: str) -> None:
    """Replace a file in one step, so that nobody reads half of it."""
    if name != "pyproject.toml" and (found := LOCATION.search(text)):
        raise SystemExit(f"{name}: {found.group()!r} names a place to download from")
    path = ROOT / f".{name}.new"
    path.write_text(text)
    os.replace(path, ROOT / name)


def disagreements() -> list[str]:
    """What is wrong with the pins as they stand; an empty list if nothing is."""
    text = (ROOT / "pyproject.toml").read_text()
    project = tomllib.loads(text)
    required = {
        RUNTIME: project["project"]["dependencies"],
        DEVELOPMENT: project["project"]["dependencies"] + project["dependency-groups"]["dev"],
    }
    constrained = pins(constraints(text))
    found = []
    for name, direct in required.items():
        file = (ROOT / name).read_text()
        entries = file.replace("\\\n", "").splitlines()
        pinned = pins(entries)
        found += [f"{name}: {n}=={v} is not among the constraints" for n, v in sorted(pinned - constrained)]
        found += [f"{name}: no hash for {entry.split()[0]}" for entry in entries if "--hash=" not in entry]
        found += [f"{name}: {word!r} names a place to download from" for word in LOCATION.findall(file)]
        wanted = {re.match(r"[\w.-]+", d).group().lower().replace("_", "-") for d in direct}
        found += [f"{name}: {n} is not pinned" for n in sorted(wanted - {n for n, _ in pinned})]
    lock = ROOT / "uv.lock"
    if lock.exists():
        packages = tomllib.loads(lock.read_text())["package"]
        locked = {(p["name"], p["version"]) for p in packages if p["name"] != project["project"]["name"]}
        found += [f"uv.lock: {n}=={v} is not among the constraints" for n, v in sorted(locked - constrained)]
        found += [f"constraints: {n}=={v} is not in uv.lock" for n, v in sorted(constrained - locked)]
    return found


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions of everything")
    parser.add_argument("--check", action="store_true", help="exit with 1 if the pins disagree")
    arguments = parser.parse_args()
    if arguments.check:
        found = disagreements()
        print("\n".join([*found, "run: python scripts/pin.py"]) if found else "the pins agree")
        return bool(found)
    before = (ROOT / "pyproject.toml").read_text()
    requirements, runtime, development = resolve(with_constraints(before, []) if arguments.upgrade else before)
    write(RUNTIME, runtime)
    write(DEVELOPMENT, development)
    write("pyproject.toml", with_constraints((ROOT / "pyproject.toml").read_text(), requirements))
    print(f"pinned {len(requirements)} requirements")
    return 0


if __name__ == "__main__":
    sys.exit(main())
