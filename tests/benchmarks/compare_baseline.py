"""Compare this version's poses on the rendered data sets with those of the baseline, or renew the baseline.

    python tests/benchmarks/compare_baseline.py            compare; status 3 if worse
    python tests/benchmarks/compare_baseline.py --renew    write tests/benchmarks/baseline

The baseline holds one compressed file of pose records for each group of data sets and method, without times. Records of
version 1 count as taken with `ASSUMPTIONS`.
"""

import argparse
import gzip
import io
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

from ringpose.cli.main import main

BASELINE = Path(__file__).parent / "baseline"
RENDERED = Path(__file__).resolve().parents[3] / "shared" / "data" / "rendered"

ASSUMPTIONS = ("--still", "--ring-tolerance", "0", "--rig-stability", "0")
"""As of the records of version 1: image noise and calibration errors only."""

SETS = {"still": ("rig_a", "rig_b", "variants_a", "variants_b"), "moving": ("moving_b",)}
METHODS = ("ml", "paper-constrained", "paper")
GROUPS = {"still": "kind,light", "moving": "motion"}


def pose_records(sets: tuple[str, ...], method: str) -> Iterator[dict]:
    """The records of `ringpose pose --brief` on the shots of data sets, without times, which differ in every run."""
    for name in sets:
        folder = RENDERED / name
        with redirect_stdout(io.StringIO()) as stream:
            words = ["--rig", str(folder / "rig.yaml"), "--method", method, "--brief", "--quiet", *ASSUMPTIONS]
            status = main(["pose", str(folder / "shots"), *words])
        if status not in (0, 3):  # 3: a shot has no pose
            sys.exit(status)
        for line in stream.getvalue().splitlines():
            yield json.loads(line) | {"latency_s": None, "stage_s": {}}


def write_records(folder: Path) -> None:
    """A file for each group of data sets and method; the same poses give the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    for group, sets in SETS.items():
        for method in METHODS:
            lines = [json.dumps(record, allow_nan=False) + "\n" for record in pose_records(sets, method)]
            (folder / f"{group}.{method}.jsonl.gz").write_bytes(gzip.compress("".join(lines).encode(), mtime=0))


def compare(folder: Path) -> int:
    """The highest status of `ringpose bench compare` over all groups of data sets and methods."""
    statuses = [0]
    for group, sets in SETS.items():
        truths = [word for name in sets for word in ("--truth", str(RENDERED / name / "truth.jsonl"))]
        for method in METHODS:
            sys.stdout.write(f"== {group}, {method}\n")
            name = f"{group}.{method}.jsonl.gz"
            words = [str(BASELINE / name), str(folder / name), *truths, "--by", GROUPS[group]]
            statuses.append(main(["bench", "compare", *words]))
    return max(statuses)


def run() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renew", action="store_true", help="write the records of this version as the baseline")
    options = parser.parse_args()
    if not RENDERED.is_dir():
        sys.exit(f"{RENDERED}: is not there; put the rendered data sets there")
    if options.renew:
        write_records(BASELINE)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        write_records(Path(folder))
        return compare(Path(folder))


if __name__ == "__main__":
    sys.exit(run())
