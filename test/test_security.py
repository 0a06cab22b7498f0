# SPDX-License-Identifier: Apache-2.0
"""What SECURITY.md promises of the whole package."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from imgu_ros.bags.reading import open_bag
from imgu_ros.cli.main import main
from imgu_ros.config.parameters import declarations
from imgu_ros.errors import ImguError
from imgu_ros.files.camera_info_file import read_camera_info

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGE = REPOSITORY / "imgu_ros"

#: They run what they read, or make objects of any kind of it.
RUNNING = {"eval", "exec", "compile", "os.system", "os.popen", "yaml.unsafe_load", "yaml.full_load", "runpy.run_path"}
UNSAFE = re.compile(r"(Unsafe|Full)Loader|^(C?)Loader$")
#: Modules that read objects of any kind.
OBJECTS = {"pickle", "marshal", "shelve", "dill", "joblib"}
#: The two ends of a pipe to a process of our own.
PIPE = {"replay/result_process.py"}
NETWORK = re.compile(r"(socket|socketserver|http|urllib\.request|ftplib|smtplib|xmlrpc|requests|asyncio|ssl)(\..*)?")


def sources() -> Iterator[tuple[str, ast.Module]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        yield str(path.relative_to(PACKAGE)), ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.Module) -> set[str]:
    """Return the names of all modules that are imported, as far as a statement tells: `urllib.request`."""
    names = {item.name for node in ast.walk(tree) if isinstance(node, ast.Import) for item in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{item.name}" for item in node.names)}
    return names


def test_nothing_that_is_read_is_run() -> None:
    found = []
    for name, tree in sources():
        if imported(tree) & OBJECTS and name not in PIPE:
            found.append(f"{name}: {imported(tree) & OBJECTS}")
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                function = ast.unparse(node.func)
                keywords = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
                if function in RUNNING or keywords.get("shell", "False") != "False" or "allow_pickle" in keywords:
                    found.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
            if isinstance(node, ast.Attribute | ast.Name):
                used = node.attr if isinstance(node, ast.Attribute) else node.id
                if UNSAFE.search(used) and isinstance(node, ast.Attribute) and ast.unparse(node.value) == "yaml":
                    found.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
    assert found == []


def test_nothing_connects_or_listens() -> None:
    found = {name: {each for each in imported(tree) if NETWORK.fullmatch(each)} for name, tree in sources()}
    # This machine's name, for the lock of a folder that several machines see.
    connected = {name for name, modules in found.items() if modules}
    # The last three serve pages on 127.0.0.1: `imgu view --web` and `--live`.
    served = {"view/page_server.py", "view/web_viewer.py", "ros/live_page.py"}
    assert connected == {"replay/folder_lock.py", *served}
    assert found["replay/folder_lock.py"] == {"socket"}
    for name in served:
        assert 'HOST = "127.0.0.1"' in (PACKAGE / name).read_text() or "import HOST" in (PACKAGE / name).read_text()
    tree = dict(sources())["replay/folder_lock.py"]
    used = {
        node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "socket"
    }
    assert used == {"gethostname"}


@pytest.mark.parametrize("tag", ["!!python/object/apply:pathlib.Path.touch", "!!python/object/new:os.system"])
def test_yaml_runs_nothing(tag: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = tmp_path / "made"
    value = f'{tag} ["touch {made}"]' if "system" in tag else f'{tag} [!!python/object/apply:pathlib.Path ["{made}"]]'

    parameters = tmp_path / "parameters.yaml"
    parameters.write_text(f"/**:\n  ros__parameters:\n    seed: {value}\n")
    assert main(["params", "--params-file", str(parameters), "seed"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1

    for key in ("image_width", "camera_name", "camera_matrix"):
        camera = tmp_path / "camera.yaml"
        camera.write_text(f"{key}: {value}\nimage_height: 480\n")
        with pytest.raises(ImguError):
            read_camera_info(camera)

    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {value}\n")
    with pytest.raises(ImguError), open_bag([bag]):
        pass
    assert not made.exists()


def test_the_bounds_are_those_of_the_parameters() -> None:
    text = (REPOSITORY / "SECURITY.md").read_text()
    named = set(re.findall(r"`(limits\.[a-z_]+)`", text))
    assert named <= {known.name for known in declarations()}
    assert "docs/parameters.md" in text
