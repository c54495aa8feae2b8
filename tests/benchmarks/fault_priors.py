"""How often what the detector reports of rendered shots is wrong: prior probabilities of `ringpose.estimate.faults`.

    python tests/benchmarks/fault_priors.py FOLDER...

Each folder has `shots`, `rig.yaml` and `truth.jsonl`. An end is wrong if it is farther from the true break point along
the stripe than `WRONG_SIGMAS`, and than `WRONG_PX`; a stripe is wrong if its line is that far off across it.
"""

import sys
from pathlib import Path

import numpy as np

from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.types.detection import BreakPointFlag, BreakPoints

WRONG_SIGMAS, WRONG_PX = 5.0, 1.5


def main(folders: list[str]) -> None:
    """Print the counts of each folder, and of all."""
    total = np.zeros(6, dtype=np.int64)
    print(f"{'set':16} shots  ends wrong  both of a stripe  stripes wrong")
    for folder in map(Path, folders):
        counts, rig = np.zeros(6, dtype=np.int64), read_rig(folder / "rig.yaml")
        truths = {truth.shot: truth for truth in read_truths(folder / "truth.jsonl")}
        for file in sorted((folder / "shots").glob("*.npz")):
            truth = truths.get(file.stem)
            found = detect(read_shot(file, rig=rig), rig).break_points
            if truth is None or truth.break_points_px is None or not isinstance(found, BreakPoints):
                continue
            counts += wrong(found, truth.break_points_px)
        total += counts
        report(folder.name, counts)
    report("all", total)


def wrong(found: BreakPoints, true_px: np.ndarray) -> np.ndarray:
    """Numbers of shots, ends, wrong ends, stripes, stripes with two wrong ends, and wrong stripes."""
    error_px = found.position_px - true_px
    across_px = np.abs(error_px[..., 1])
    sigma_px = np.sqrt(found.covariance_px2[..., 0, 0])
    usable = np.isfinite(error_px).all(axis=-1) & (found.flags & int(BreakPointFlag.UNCLEAR) == 0)
    stripe = usable.any(axis=1) & (np.where(usable, across_px, np.inf).min(axis=1) > WRONG_PX)
    on_face = usable & ~stripe[:, None]
    off = on_face & (np.abs(error_px[..., 0]) > np.maximum(WRONG_SIGMAS * sigma_px, WRONG_PX))
    both = off.all(axis=1)
    alone = off & ~both[:, None]
    seen = usable.any(axis=1)
    return np.array([1, on_face.sum(), alone.sum(), seen.sum(), both.sum(), stripe.sum()])


def report(name: str, counts: np.ndarray) -> None:
    """One line of the table."""
    shots, ends, alone, stripes, both, stripe = counts.tolist()
    print(
        f"{name:16} {shots:5}  {alone}/{ends} = {alone / max(ends, 1):.1e}  {both}/{stripes} = "
        f"{both / max(stripes, 1):.1e}  {stripe}/{stripes} = {stripe / max(stripes, 1):.1e}",
        flush=True,
    )


if __name__ == "__main__":
    main(sys.argv[1:])
