# SPDX-License-Identifier: Apache-2.0
"""Record what the real `ros2 launch` gives to the processes that it starts, byte for byte.

    python test/launch_files/record.py [FOLDER]

Needs `ros2 launch` on PATH (ros2cli, launch, launch_ros). It runs the launch files of the package and those beside this
script with a stand-in for the `imgu` command, which keeps its arguments and parameter files, in `recorded/` or FOLDER.
Run it after a change of a launch file; `test/test_launch.py` reads what it wrote.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
#: Environment variables that a launch file may set for a process.
VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")

#: Keeps arguments, and files among them, in the folder `$IMGU_RECORD`; the files are gone afterwards.
STAND_IN = f"""#!{sys.executable}
import os, shlex, shutil, sys, tempfile
from pathlib import Path
folder = Path(tempfile.mkdtemp(dir=os.environ["IMGU_RECORD"]))
words = []
for word in sys.argv[1:]:
    # As launch_ros names its own files, in its folder or as given.
    if Path(word).name.startswith("launch_params_") and Path(word).is_file():
        name = f"params_{{len(list(folder.iterdir()))}}.yaml"
        shutil.copy(word, folder / name)
        word = name
    words.append(word)
given = [f"{{name}}={{os.environ[name]}}" for name in {VARIABLES!r} if name in os.environ]
(folder / "command").write_text(shlex.join([*given, "imgu", *words]) + "\\n")
"""


def record(target: Path) -> None:
    """Run every line of `launches.txt` and keep what it started."""
    work = Path(tempfile.mkdtemp())
    prefix = work / "prefix"
    share = prefix / "share" / "imgu_ros"
    (prefix / "share" / "ament_index" / "resource_index" / "packages").mkdir(parents=True)
    (prefix / "share" / "ament_index" / "resource_index" / "packages" / "imgu_ros").touch()
    for name in ("launch", "config"):
        shutil.copytree(REPOSITORY / name, share / name)
    command = prefix / "lib" / "imgu_ros" / "imgu"
    command.parent.mkdir(parents=True)
    command.write_text(STAND_IN)
    command.chmod(0o755)
    shutil.rmtree(target, ignore_errors=True)
    for line in (HERE / "launches.txt").read_text().splitlines()[1:]:  # after the licence
        case, _, text = line.partition(": ")
        caught = work / case
        caught.mkdir()
        environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
        environment |= {"IMGU_RECORD": str(caught), "TMPDIR": str(caught), "ROS_LOG_DIR": str(work / "log")}
        prefixes = [str(prefix), environment.get("AMENT_PREFIX_PATH", "")]
        environment["AMENT_PREFIX_PATH"] = os.pathsep.join(filter(None, prefixes))
        words = ["ros2", "launch", *shlex.split(text)]
        subprocess.run(words, cwd=HERE, env=environment, check=True, timeout=60, stdout=subprocess.DEVNULL)
        folders = [folder for folder in caught.iterdir() if (folder / "command").is_file()]
        for number, folder in enumerate(sorted(folders, key=lambda folder: (folder / "command").read_text())):
            shutil.copytree(folder, target / f"{case}_{number}")
    shutil.rmtree(work)


if __name__ == "__main__":
    record(Path(sys.argv[1]) if sys.argv[1:] else HERE / "recorded")
