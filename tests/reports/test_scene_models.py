from reports.scene_models import scene_models_text


def test_gain_and_price_of_a_scene_model_stand_side_by_side():
    full = {"model": "full", "bytes": 12_345, "ns": 61.27, "steps": 4000, "seconds": 12.34}
    full |= {"psnr": 33.456, "flip": 0.06789, "outside": 28.1}
    scene = full | {"model": "scene", "bytes": 2_345, "psnr": None, "outside": None}
    lines = scene_models_text([full, scene]).splitlines()
    assert lines[-3].split() == ["full", "12,345", "61.3", "4,000", "12.3", "33.46", "0.0679", "28.10"]
    assert lines[-2].split() == ["scene", "2,345", "61.3", "4,000", "12.3", "—", "0.0679", "—"]
