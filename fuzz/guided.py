# SPDX-License-Identifier: Apache-2.0
"""Fuzz one kind guided by coverage, for hours by hand; needs Atheris: `pip install atheris`.

    python -m fuzz.guided mcap FOLDER -max_total_time=3600

FOLDER keeps the inputs that reached new code, from run to run. Mutations are those of `python -m fuzz`, now and then
libFuzzer's own. What fails ends the run and is saved by libFuzzer; read it again with
`python -m fuzz --kind mcap --replay crash-...`. Further options are libFuzzer's (`-help=1`).
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

try:
    import atheris  # type: ignore[import-not-found, import-untyped, unused-ignore]
except ImportError:
    raise SystemExit("atheris: not installed; need: pip install atheris") from None

with atheris.instrument_imports(include=["imgu_ros", "rosbags", "yaml"]):
    from fuzz.harness import fuzz_one

from fuzz.kinds import KINDS
from fuzz.pool import MOST_MB, MOST_SECONDS

_OWN_SHARE = 0.9


def main() -> None:
    """Run libFuzzer."""
    if len(sys.argv) < 3 or sys.argv[1] not in KINDS or len(KINDS[sys.argv[1]].seeds()[0]) > 1:
        single = " ".join(name for name, kind in KINDS.items() if len(kind.seeds()[0]) == 1)
        raise SystemExit(f"usage: python -m fuzz.guided KIND FOLDER [libFuzzer's options]; KIND: {single}")
    kind, inputs = KINDS[sys.argv[1]], Path(sys.argv[2])
    inputs.mkdir(parents=True, exist_ok=True)
    (name,) = kind.seeds()[0]
    for i, seed in enumerate(kind.seeds()):
        (inputs / f"seed-{i}").write_bytes(next(iter(seed.values())))
    bounds = [f"-timeout={MOST_SECONDS:.0f}", f"-rss_limit_mb={MOST_MB:.0f}", "-max_len=1000000"]

    def read(data: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            path.write_bytes(data)
            verdict, complete = fuzz_one(kind.reader, path)
            complete()
        if verdict.failures:
            raise AssertionError("\n".join([*verdict.failures, verdict.details]))

    def mutated(data: bytes, most: int, seed: int) -> bytes:
        rng = np.random.default_rng(seed)
        if rng.random() > _OWN_SHARE:
            return bytes(atheris.Mutate(data, most))
        return next(iter(kind.mutate(rng, {name: data}).values()))[:most]

    atheris.Setup([sys.argv[0], str(inputs), *bounds, *sys.argv[3:]], read, custom_mutator=mutated)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
