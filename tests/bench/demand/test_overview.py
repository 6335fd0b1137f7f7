from bench.demand.overview import draw
from tests.bench.demand.scenes import SUN, camera, demand_of, surface


def test_a_users_settings_of_matplotlib_do_not_reach_the_picture_of_a_demand(tmp_path, users_settings):
    demand = demand_of(camera(20, 10, 40, [0, 0, 2], up=[0, 1, 0]) + surface(size=[4, 4], repeat=[2, 2]) + SUN)
    draw(demand, tmp_path / "plain.png")
    with users_settings():
        draw(demand, tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "plain.png").read_bytes()
