import numpy as np
import pytest

from yesnt.relight.albedo import albedo_tables, disney_albedo, energy_terms
from yesnt.relight.brdf import (
    alpha_ggx,
    dielectric_fresnel,
    disney_diffuse,
    evaluate_paper,
    ggx_distribution,
    schlick_weight,
    smith_visibility,
)


def hemisphere(theta=400, phi=400):
    """Midpoint directions [N, 3] and solid angles [N]."""
    t, p = np.meshgrid((np.arange(theta) + 0.5) / theta * np.pi / 2, (np.arange(phi) + 0.5) / phi * 2 * np.pi)
    direction = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    return direction, (np.sin(t) * (np.pi / 2 / theta) * (2 * np.pi / phi)).ravel()


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_reciprocity(roughness, metallic):
    rng = np.random.default_rng(1)
    light, view = (rng.normal(size=(200, 3)) for _ in range(2))
    light, view = (np.abs(a) / np.linalg.norm(a, axis=1, keepdims=True) for a in (light, view))
    normal = np.array([0, 0, 1.0])
    rest = (np.full((200, 3), 0.5), np.full(200, roughness), np.full(200, metallic))
    one, two = evaluate_paper(normal, light, view, *rest), evaluate_paper(normal, view, light, *rest)
    for a, b in zip(one, two, strict=True):
        assert np.allclose(a, b, rtol=1e-5)


def test_the_distribution_is_normalised():
    direction, solid = hemisphere()
    for roughness in (0.2, 0.5, 1.0):
        value = ggx_distribution(direction[:, 2], alpha_ggx(np.array(roughness)))
        assert np.isclose((value * direction[:, 2] * solid).sum(), 1, atol=2e-3)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("cos_o", [0.2, 0.6, 0.95])
def test_albedo_tables_against_quadrature(roughness, cos_o):
    light, solid = hemisphere(500, 500)
    view = np.array([np.sqrt(1 - cos_o**2), 0, cos_o])
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    alpha = alpha_ggx(np.array(roughness))
    lobe = ggx_distribution(half[:, 2], alpha) * smith_visibility(light[:, 2], np.array(cos_o), alpha)
    weight, cos_d, tables = lobe * light[:, 2] * solid, half @ view, albedo_tables()
    for table, fresnel in (
        (tables.white, 1.0),
        (tables.dielectric, dielectric_fresnel(cos_d)),
        (tables.schlick, schlick_weight(cos_d)),
    ):
        assert np.isclose(tables.lookup(table, roughness, cos_o), (weight * fresnel).sum(), atol=2e-3, rtol=5e-3)


def test_the_layer_and_its_lobe_share_the_energy():
    roughness, cos_o = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0.01, 1, 21))
    terms, tables = energy_terms(roughness, cos_o), albedo_tables()
    lobe = terms.dielectric * tables.lookup(tables.dielectric, roughness, cos_o)
    assert np.allclose(lobe + terms.layer, 1)
    assert (lobe >= 0).all()
    assert (lobe <= 1).all()


def test_fresnel_at_normal_and_grazing():
    assert np.isclose(dielectric_fresnel(np.array(1.0)), 0.04)
    assert np.isclose(dielectric_fresnel(np.array(0.0)), 1.0)
    assert alpha_ggx(np.array(0.0)) == 1e-3


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_disney_diffuse_is_reciprocal_and_its_table_is_its_integral(roughness):
    light, solid = hemisphere(200, 200)
    for cos_o in (0.2, 0.6, 0.95):
        view = np.array([np.sqrt(1 - cos_o**2), 0, cos_o])
        cos_d = np.sqrt(0.5 * (1 + light @ view))
        value = disney_diffuse(light[:, 2], np.array(cos_o), cos_d, np.array(roughness))
        assert np.allclose(value, disney_diffuse(np.array(cos_o), light[:, 2], cos_d, np.array(roughness)))
        integral = (value * light[:, 2] * solid).sum() / np.pi
        assert np.isclose(albedo_tables().lookup(disney_albedo(), roughness, cos_o), integral, rtol=5e-3)
