"""`plan` says of every term of the model whether a shot needs it, and why."""

from dataclasses import replace

import numpy as np
import pytest

from yesnt.relight import EnvMap, RelightSettings, prepare_light, requirements
from yesnt.relight.scope import SceneFacts

SETTINGS = RelightSettings()
LEVELS = "map filtered for metal in metal"


def light(sun: float = 1.0):
    """A uniform map with one texel of another radiance."""
    radiance = np.ones((16, 32, 3), np.float32)
    radiance[4, 20] = sun
    return prepare_light(EnvMap.from_array(radiance), 256, 16)


UNIFORM, SUNNY = light(), light(1000.0)
FACTS = SceneFacts(UNIFORM, UNIFORM, True, (0.3, 0.6), (0.0, 1.0), 0.0)
CASES = {
    "metal": (FACTS, SETTINGS, "metallic lobe", True, "pixels that are metallic"),
    "no metal": (replace(FACTS, metallic=(0.0, 0.001)), SETTINGS, "metallic lobe", False, "no pixel is metallic"),
    "metal unknown": (replace(FACTS, metallic=None), SETTINGS, "metallic lobe", True, "pixels that are metallic"),
    "paper": (FACTS, replace(SETTINGS, brdf="paper"), "metallic lobe", True, "one lobe"),
    "levels": (FACTS, SETTINGS, LEVELS, True, "0.30 to 0.60"),
    "levels of unknown roughness": (replace(FACTS, roughness=None), SETTINGS, LEVELS, True, "at most"),
    "one level": (replace(FACTS, roughness=(0.5, 0.5)), SETTINGS, LEVELS, True, "one level"),
    "no metal to mirror": (replace(FACTS, metallic=(0.0, 0.0)), SETTINGS, LEVELS, False, "no pixel is metallic"),
    "no bounce to mirror": (FACTS, replace(SETTINGS, bounce=0), LEVELS, False, "no indirect radiance"),
    "paper's shadow mirrors nothing": (FACTS, replace(SETTINGS, shadows="single"), LEVELS, False, "no indirect"),
    "nothing to mirror": (replace(FACTS, proxy=False), SETTINGS, LEVELS, False, "no indirect radiance"),
    "no sun": (FACTS, SETTINGS, "sun", False, "% of the light"),
    "sun": (replace(FACTS, light=SUNNY), SETTINGS, "sun", True, "its own shadow"),
    "sun unknown": (replace(FACTS, light=None), SETTINGS, "sun", True, "not known"),
    "shadows": (FACTS, SETTINGS, "shadows", True, "16 rays a pixel"),
    "shadows of an unknown light": (replace(FACTS, light=None), SETTINGS, "shadows", True, "at most"),
    "no shadows": (FACTS, replace(SETTINGS, shadows=False), "shadows", False, "switched off"),
    "paper's shadows": (FACTS, replace(SETTINGS, shadows="single"), "shadows", True, "one factor"),
    "shadows without proxy": (replace(FACTS, proxy=False), SETTINGS, "shadows", True, "no proxy mesh"),
    "bounce": (FACTS, SETTINGS, "bounce", True, "off the proxy"),
    "no bounce": (FACTS, replace(SETTINGS, bounce=0), "bounce", False, "switched off"),
    "bounce without shadows": (FACTS, replace(SETTINGS, shadows=False), "bounce", False, "switched off"),
    "bounce without proxy": (replace(FACTS, proxy=False), SETTINGS, "bounce", False, "no proxy mesh"),
    "uniform capture": (FACTS, SETTINGS, "capture light", True, "uniform"),
    "capture": (replace(FACTS, capture=SUNNY), SETTINGS, "capture light", True, "taken out of the plate"),
    "capture kept": (FACTS, replace(SETTINGS, base_color="plate"), "capture light", False, "as in the paper"),
    "filter": (FACTS, SETTINGS, "pixel filter", True, "0.0 % of the first frame's"),
    "filtered": (replace(FACTS, short=0.5), SETTINGS, "pixel filter", False, "50.0 %"),
    "filter off": (FACTS, replace(SETTINGS, pixel_filter=0), "pixel filter", False, "switched off"),
    "filter unknown": (replace(FACTS, short=None), SETTINGS, "pixel filter", True, "unit length"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_term_is_modelled_or_left_out_with_its_reason(case):
    facts, settings, term, modelled, reason = CASES[case]
    found = next(r for r in requirements(facts, settings) if r.term == term)
    assert found.modelled == modelled
    assert reason in found.reason


def test_sharper_lobes_ask_for_finer_texels():
    env = EnvMap.from_array(np.random.default_rng(0).random((64, 128, 3)).astype(np.float32))
    facts = replace(FACTS, light=prepare_light(env, 2048, 64))
    found = []
    for roughness in (0.9, 0.02):
        told = requirements(replace(facts, roughness=(roughness, 1.0)), SETTINGS)
        found.append(next(r for r in told if "fine" in r.term))
    assert [one.modelled for one in found] == [False, True]
    assert "0.90" in found[0].reason
    assert "begins at 0.02" in found[1].reason
