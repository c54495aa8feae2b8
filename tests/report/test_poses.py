"""The page of `ringpose pose --report`."""

from ringpose.report.poses import pose_report


def test_a_report_of_no_shots_is_a_page():
    page = pose_report([], [], "no shots")

    assert page.startswith("<!DOCTYPE html>")
    assert "no shots" in page
