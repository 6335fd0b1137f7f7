from typing import Any

from bench.demand.collect import collect
from bench.demand.demand import Demand
from bench.demand.scene import parse_scene
from bench.demand.text_scene import TextScene


def table(head: str, **values: Any) -> str:
    return f"{head}\n" + "".join(f"{key} = {value!r}\n".replace("'", '"') for key, value in values.items())


def camera(width: int, height: int, fov_deg: int, position: list[float], **more: Any) -> str:
    values = {"width": width, "height": height, "fov_deg": fov_deg, "position": position, "target": [0, 0, 0]}
    return table("[camera]", **values | more)


def surface(**values: Any) -> str:
    return table("[surface]", **values)


def light(kind: str, **values: Any) -> str:
    return table("[[lights]]", kind=kind, **values)


SUN = light("directional", toward=[0.6, 0, 0.8], irradiance=[1, 2, 3])


def demand_of(text: str, limit: int = 10**6) -> Demand:
    return collect(TextScene(parse_scene("test", text)), limit)
