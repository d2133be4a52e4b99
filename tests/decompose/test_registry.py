import sys

import pytest

from yesnt.core.errors import JobError, MissingPartError
from yesnt.decompose import latents, registry


def test_unknown_backend_lists_the_known():
    with pytest.raises(JobError, match="embedded, marigold, rgbx"):
        registry.open_backend("magic")


def test_large_backend_without_weights_says_where_they_are_published():
    with pytest.raises(JobError, match="Hugging Face"):
        registry.open_backend("marigold")


def test_non_commercial_licence_needs_consent_by_name_before_anything_is_read(tmp_path):
    with pytest.raises(JobError, match=r"--accept-license 'Adobe-Research'"):
        registry.open_backend("rgbx", tmp_path)
    with pytest.raises(JobError, match=r"zheng95z/rgb-to-x"):
        registry.open_backend("rgbx", tmp_path, accepted_licences=["Adobe-Research"])


def test_entries_state_the_licence_that_the_backend_carries():
    from yesnt.decompose.embedded import EmbeddedBackend
    from yesnt.decompose.marigold import MarigoldBackend
    from yesnt.decompose.rgbx import RgbxBackend

    for backend in (EmbeddedBackend, MarigoldBackend, RgbxBackend):
        assert registry.ENTRIES[backend.name].licence == backend.licence


def test_missing_package_names_backend_and_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(MissingPartError, match=r"rgbx.*yesnt\[diffusers\]"):
        latents.diffusers_for("rgbx")
