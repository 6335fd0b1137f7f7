from reports.scene_models import scene_models_text


def test_gain_and_price_of_a_scene_model_stand_side_by_side():
    full = {"model": "full", "bytes": 12_345, "ns": 61.27, "steps": 4000, "seconds": 12.34}
    full |= {"psnr": 33.456, "flip": 0.06789, "outside": 28.1, "held_out": 30.25}
    scene = full | {"model": "scene", "bytes": 2_345, "psnr": None, "outside": None, "held_out": 31.5}
    text = scene_models_text([full, scene])
    gain = "The model of the scene takes 2,345 instead of 12,345 bytes (19%), +1.25 dB at held-out pairs."
    assert gain in " ".join(text.split())
    lines = [line for line in text.splitlines() if line.startswith(("full ", "scene "))]
    assert lines[0].split() == ["full", "12,345", "61.3", "4,000", "12.3", "30.25", "33.46", "0.0679", "28.10"]
    assert lines[1].split() == ["scene", "2,345", "61.3", "4,000", "12.3", "31.50", "—", "0.0679", "—"]
