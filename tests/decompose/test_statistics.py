import torch

from yesnt.decompose.statistics import STATISTICS, colour_code, local_statistics


def test_hues_do_not_depend_on_the_exposure():
    rgb = torch.rand(1, 3, 8, 8) + 0.3
    once, twice = colour_code(rgb), colour_code(2 * rgb)
    torch.testing.assert_close(once[:, 1:], twice[:, 1:], atol=0.08, rtol=0)
    assert (twice[:, 0] > once[:, 0]).all()


def test_a_flat_patch_has_no_contrast_and_what_is_outside_does_not_count():
    code = torch.full((1, 3, 64, 64), 0.4)
    matte = torch.zeros(1, 1, 64, 64)
    matte[..., 16:48, 16:48] = 1
    code = code + 5 * (1 - matte)
    planes = local_statistics(code, matte)
    assert planes.shape == (1, STATISTICS, 32, 32)
    # Shrunken sizes are read back bilinearly and lean on nothing at the matte's very border.
    assert float(planes[..., 12:20, 12:20].abs().max()) < 0.1
    assert not planes[..., :8, :].any()


def test_a_white_highlight_shows_in_gloss_and_tint():
    red = torch.tensor([0.5, 0.1, 0.1])[None, :, None, None].expand(1, 3, 64, 64).clone()
    matte = torch.ones(1, 1, 64, 64)
    flat = local_statistics(colour_code(red), matte)
    red[..., 30:34, 30:34] = 2.0
    shiny = local_statistics(colour_code(red), matte)
    gloss, tint = shiny[0, 7 + 4, 16, 16] - flat[0, 7 + 4, 16, 16], shiny[0, 7 + 5, 16, 16] - flat[0, 7 + 5, 16, 16]
    assert gloss > 0.5
    assert tint < -0.5, "the bright is less red than the rest"
