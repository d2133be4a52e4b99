import sys

import pytest

from yesnt.decompose import registry
from yesnt.decompose.backend import Licence
from yesnt.errors import JobError, MissingPartError


def test_unknown_backend_lists_the_known():
    with pytest.raises(JobError, match="embedded, marigold"):
        registry.open_backend("magic")


def test_large_backend_without_weights_says_where_they_are_published():
    with pytest.raises(JobError, match="Hugging Face"):
        registry.open_backend("marigold")


def test_non_commercial_licence_needs_consent_by_name(fake, monkeypatch):
    class Restricted(fake):
        licence = Licence("Some-NC-1.0", commercial=False)

    monkeypatch.setitem(registry._OPENERS, "restricted", lambda folder: Restricted())
    with pytest.raises(JobError, match=r"--accept-license 'Some-NC-1\.0'"):
        registry.open_backend("restricted")
    assert registry.open_backend("restricted", accepted_licences=["Some-NC-1.0"]).name == "fake"


def test_missing_package_names_the_extra(tmp_path, monkeypatch):
    from yesnt.decompose import marigold

    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(MissingPartError, match=r"yesnt\[diffusers\]"):
        marigold._load(tmp_path)
