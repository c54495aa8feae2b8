"""The ring's edges on shots that this project did not make, in laboratory light and in the sun."""

import json

import numpy as np
import pytest
from true_edges import edge_errors_px

from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig

pytestmark = pytest.mark.slow

FOLDERS = ["rig_a", "rig_b", "variants_a", "variants_b"]


@pytest.fixture(scope="module")
def edges(shared_data):
    """Errors and sigmas of the edge points of each shot by its name and light; None for a shot without."""
    found = {}
    for folder in FOLDERS:
        root = shared_data / "rendered" / folder
        rig = read_rig(root / "rig.yaml")
        for line in (root / "truth.jsonl").read_text().splitlines():
            truth = json.loads(line)
            points = detect(read_shot(root / "shots" / f"{truth['shot']}.npz"), rig).ring_edges
            light = "chamfer" if truth["groups"]["kind"] == "chamfer" else truth["groups"]["light"]
            off = None if points is None else (edge_errors_px(points, truth, rig), points.sigma_px)
            found[truth["shot"], light] = off
    return found


def lit(edges: dict, light: str) -> list:
    return [off for (_, each), off in edges.items() if each == light and off is not None]


@pytest.mark.parametrize(("light", "limit_px"), [("normal", 0.3), ("strong", 0.12), ("glare", 0.1)])
def test_edges_are_found_to_a_fraction_of_a_pixel(edges, light, limit_px):
    error_px = np.concatenate([error for error, _ in lit(edges, light)])

    assert 1.4826 * np.median(np.abs(error_px)) < limit_px


def test_no_shot_has_a_bias_of_a_tenth_of_a_pixel(edges):
    shots = lit(edges, "normal") + lit(edges, "strong") + lit(edges, "glare")

    biases_px = [np.sum(error / sigma**2) / np.sum(sigma**-2) for error, sigma in shots]

    assert np.abs(biases_px).max() < 0.1


@pytest.mark.parametrize("light", ["normal", "strong"])
def test_sigmas_are_honest(edges, light):
    squares = np.concatenate([(error / sigma) ** 2 for error, sigma in lit(edges, light)])

    assert 0.8 < np.mean(squares) < 1.25
    assert np.mean(squares > 25) < 0.001


def test_most_lit_shots_show_a_hundred_points(edges):
    counts = [len(error) for light in ("normal", "strong") for error, _ in lit(edges, light)]

    assert np.median(counts) > 120
    assert len(counts) >= 22


def test_edges_that_show_in_the_light_of_stripes_alone_are_the_rings(edges):
    shots = lit(edges, "dim")

    assert 1 <= len(shots) <= 2
    assert all(np.mean((error / sigma) ** 2) < 1.25 for error, sigma in shots)
    assert all(np.abs(error / sigma).max() < 5 for error, sigma in shots)
