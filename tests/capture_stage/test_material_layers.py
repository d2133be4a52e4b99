import json

import numpy as np
import pytest

from yesnt.capture_stage import garments, shape_materials, shapes
from yesnt.capture_stage.material_layers import (
    Between,
    Layer,
    coverage,
    displacement,
    fields_of,
    layers_to_json,
    vertex_normals,
)

COSTUMES = [garments.explorer, garments.athlete, garments.performer, garments.courtier]
MATERIALS = [shape_materials.worn_metal, shape_materials.glaze, shape_materials.brocade]


def _layer(thickness: float, *where: Between) -> Layer:
    return Layer("cloth", where, "plain", ((0.5, 0.5, 0.5), (0.4, 0.4, 0.4)), 1, (0.5, 0.6), 0.0, thickness, 0.1)


def test_cover_fades_inside_its_borders_only():
    fields = {"z": np.array([-0.1, 0.0, 0.05, 0.1, 0.5, 1.0])}
    assert coverage(_layer(0.01, Between("z", 0.0, 1.0)), fields) == pytest.approx([0, 0, 0.5, 1, 1, 0])


def test_the_topmost_layer_decides_the_height():
    fields = {"z": np.array([0.5, 1.5])}
    layers = (_layer(0.02, Between("z", 0, 10)), _layer(0.005, Between("z", 1, 10)), _layer(0.0))
    assert displacement(layers, fields) == pytest.approx([0.02, 0.005])


@pytest.mark.parametrize("make", COSTUMES + MATERIALS)
def test_layers_are_physical_and_plain_data(make):
    layers = make()
    assert json.loads(json.dumps(layers_to_json(layers))) == layers_to_json(layers)
    for layer in layers:
        assert 0.05 <= layer.roughness[0] <= layer.roughness[1] <= 1
        assert layer.metallic in (0.0, 1.0)
        assert all(0 <= c <= 1 for color in layer.colors for c in color)


def test_the_stage_spreads_over_roughness_and_metallic():
    layers = [layer for make in COSTUMES + MATERIALS for layer in make()]
    assert min(layer.roughness[0] for layer in layers) <= 0.06
    assert max(layer.roughness[1] for layer in layers) == 1.0
    assert 0.2 < np.mean([layer.metallic for layer in layers]) < 0.6


@pytest.mark.parametrize(("build", "make"), [
    (shapes.knot, shape_materials.worn_metal), (shapes.vase, shape_materials.glaze),
    (shapes.drape, shape_materials.brocade),
])  # fmt: skip
def test_shapes_stand_on_the_ground_and_have_the_fields_that_their_coat_asks_for(build, make):
    vertices, faces, fields = build()
    assert vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
    assert faces.max() == len(vertices) - 1
    assert np.isfinite(vertices).all()
    assert set(fields_of(make())) <= set(fields)
    assert all(len(values) == len(vertices) for values in fields.values())


def test_shapes_are_wound_outwards():
    vertices, faces, _ = shapes.vase()
    belly = (vertices[:, 2] > 0.2) & (vertices[:, 2] < 0.8) & (np.hypot(vertices[:, 0], vertices[:, 1]) > 0.2)
    outer = belly & (np.arange(len(vertices)) < 141 * 96)
    outward = (vertex_normals(vertices, faces)[:, :2] * vertices[:, :2]).sum(axis=1)
    assert (outward[outer] > 0).all()
