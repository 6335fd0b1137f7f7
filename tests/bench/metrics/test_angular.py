import numpy as np
import pytest

from bench.metrics.angular import THETA_EDGES_DEG, grazing, polar_map


def direction(theta, phi=0.0):
    theta, phi = np.radians(np.broadcast_arrays(theta, phi))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).astype(np.float32)


def mean(raw):
    return float(np.mean(raw))


def test_sixty_degrees_is_not_grazing_and_more_is():
    # In float32 the angle of a grid's 60° may come out a hair above or below.
    assert grazing(direction([0, 59.9, 60, 60.1, 75])).tolist() == [False, False, False, True, True]


def test_a_polar_map_pools_each_cell():
    pooled = polar_map(direction([50, 50, 50, 80], [0, 359, 91, 185]), np.array([1.0, 3, 5, 7]), mean)
    assert pooled["theta_edges_deg"] == list(THETA_EDGES_DEG)
    assert pooled["phi_centres_deg"][:4] == [0, 30, 60, 90]
    assert (pooled["value"][3][0], pooled["value"][3][3], pooled["value"][5][6]) == (2, 5, 7)
    pole = polar_map(direction([1, 5], [10, 200]), np.array([1.0, 2]), mean)
    assert pole["value"][0] == [pytest.approx(1.5)] * 12
