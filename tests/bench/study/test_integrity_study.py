"""A sub-sample of the study of faults: errors stay within their protection levels."""

from dataclasses import replace

import pytest

from ringpose.bench.integrity import clopper_pearson
from ringpose.bench.study.shots import study_rows
from ringpose.bench.study.table import summarized
from ringpose.files.studies.specification import read_study, study_path
from ringpose.types.study import DRAWN_FAULTS, NO_FAULT, RUN_FAULTS, StudyMethod

SHOTS = 6
AT_MOST = 0.05
"""Share of misleading lines, given one fault, that the sub-sample would exceed if it were usual."""


@pytest.mark.slow
def test_single_faults_do_not_mislead_and_right_shots_are_available():
    study = read_study(study_path("integrity"), count=SHOTS)
    kinds = replace(study.factors[0], drawn=False, shares=())
    study = replace(study, methods=(StudyMethod.ML,), factors=(kinds, *study.factors[1:]))
    single = (NO_FAULT, *DRAWN_FAULTS, *(fault for fault in RUN_FAULTS if fault != "radius"))
    cells = [place for place, kind in enumerate(kinds.values) if kind in single]
    indices = [cell + turn * study.cells for turn in range(SHOTS) for cell in cells]

    counts = summarized(study, (row for index in indices for row in study_rows(study, index))).integrity

    assert sum(each.lines for each in counts.values()) == len(indices)
    assert not sum(counts["ml", kind].misled for kind in (NO_FAULT, "tails", "sigmas"))
    assert counts["ml", NO_FAULT].available >= SHOTS - 1
    misled, leveled = (
        sum(of(each) for each in counts.values()) for of in (lambda e: e.misled, lambda e: max(e.leveled.values()))
    )
    assert clopper_pearson(misled, leveled)[0] < AT_MOST
