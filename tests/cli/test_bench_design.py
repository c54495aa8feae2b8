"""`ringpose bench design`: tables, CSV, the best rig, and what is refused."""

import csv
from pathlib import Path

import pytest
from needed import needed_module

from ringpose.cli.main import main
from ringpose.files.rigs import read_rig

RIG = str(Path(__file__).parents[2] / "examples" / "scene-rig.yaml")
SMALL = ["bench", "design", RIG, "--distances", "0.5", "--offsets", "0"]


def test_a_sweep_writes_a_table_all_places_and_the_best_rig(tmp_path, capsys):
    files = ["--csv", str(tmp_path / "map.csv"), "-o", str(tmp_path / "best.yaml")]

    assert main([*SMALL, "--vary", "laser_angle_rad=0.1,0.2", *files]) == 0

    assert "best by center: +-11.5 deg" in capsys.readouterr().out
    with (tmp_path / "map.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["rig"] for row in rows][:3] == ["as given", "+-5.73 deg", "+-11.5 deg"]
    assert float(rows[0]["sd_center_m"]) > 0
    assert read_rig(tmp_path / "best.yaml").lasers.normal[-1, 2] == pytest.approx(0.199, abs=1e-3)


def test_without_a_rig_that_covers_the_volume_the_status_is_3(capsys):
    assert main(["bench", "design", RIG, "--distances", "0.1", "--offsets", "0"]) == 3
    assert "none" in capsys.readouterr().out


@pytest.mark.slow
def test_the_limits_of_a_ring_of_given_outer_radius_are_stated(capsys):
    main([*SMALL, "--radius-outer", "0.1"])

    out = capsys.readouterr().out
    assert "a ring of 0.1 m, its face 25 mm wide" in out
    assert "the whole ring in the middle of the image: three stripes" in out


@pytest.mark.slow
def test_a_report_has_maps(tmp_path):
    needed_module("matplotlib", "ringpose[report]")

    assert main([*SMALL, "--report", str(tmp_path / "page.html")]) == 0
    assert (tmp_path / "page.html").read_text().count("<img") == 5


@pytest.mark.parametrize(
    ("words", "word"),
    [
        (["--vary", "laser_angel_rad=0.1"], "laser_angle_rad"),
        (["--vary", "laser_angle_rad=ten"], "ten"),
        (["--vary", "lasers=2.5"], "2.5"),
        (["--vary", "focal_px=1"], "focal_px"),
        (["--vary", "baseline_m=" + ",".join(str(0.1 + n / 1000) for n in range(600))], "600"),
        (["--distances", "-1"], "--distances"),
        (["--offsets", "wide"], "wide"),
        (["--radius-inner", "0.6"], "--radius-outer"),
        (["--minimize", "size"], "size"),
    ],
)
def test_bad_options_are_a_wrong_usage(capsys, words, word):
    assert main([*SMALL, *words]) == 2
    assert word in capsys.readouterr().err


def test_a_rig_without_projectors_or_file_is_rejected(tmp_path, capsys):
    rig = tmp_path / "rig.yaml"
    lines = Path(RIG).read_text().splitlines()
    rig.write_text(
        "\n".join(line.partition(", projector_m")[0] + "}" if "projector_m" in line else line for line in lines)
    )

    assert main(["bench", "design", str(rig)]) == 65
    assert "projector" in capsys.readouterr().err
    assert main(["bench", "design", str(tmp_path / "none.yaml")]) == 66
