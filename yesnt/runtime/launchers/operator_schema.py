"""Validates manifests against the schemas of Dask's Kubernetes operator, which its package carries."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from yesnt.core.errors import MissingPartError, UsageError

CRDS = "operator/deployment/helm/dask-kubernetes-operator/crds"


def check_manifest(manifest: Mapping[str, Any]) -> None:
    """Refuses a manifest that the operator would not accept, or of which the API server would drop a part in silence.

    Raises:
        UsageError: names the place in the manifest.
        MissingPartError: the operator's package is absent.
    """
    import jsonschema

    schema = _schemas().get(str(manifest["kind"]))
    if schema is None:  # Kubernetes' own kinds
        return
    problem = jsonschema.exceptions.best_match(jsonschema.Draft202012Validator(schema).iter_errors(manifest))
    if problem is not None:
        where = ".".join(str(part) for part in problem.absolute_path)
        raise UsageError(
            f"The operator's schema refuses the manifest: {problem.message}", f"{manifest['kind']}, {where}",
            "what the installed operator accepts", "correct the cluster profile, or update dask-kubernetes",
        )  # fmt: skip


@cache
def _schemas() -> dict[str, Any]:
    """Schema of each kind of the operator; unknown fields are refused."""
    import yaml

    return {
        kind: _closed(_with_metadata(document["spec"]["versions"][0]["schema"]["openAPIV3Schema"]))
        for kind, path in (("DaskCluster", "daskcluster.yaml"), ("DaskWorkerGroup", "daskworkergroup.yaml"))
        for document in [yaml.safe_load((operator_folder() / CRDS / path).read_text())]
    }


def operator_folder() -> Path:
    """The folder of the operator's package.

    Raises:
        MissingPartError: it is absent.
    """
    spec = importlib.util.find_spec("dask_kubernetes")
    if spec is None or not spec.submodule_search_locations:
        raise MissingPartError(
            "Kubernetes clusters need dask-kubernetes", "dask_kubernetes", "the extra kubernetes",
            "pip install 'yesnt[kubernetes]'",
        )  # fmt: skip
    return Path(spec.submodule_search_locations[0])


def _with_metadata(schema: Mapping[str, Any]) -> dict[str, Any]:
    """A schema with what every object has, which the operator's does not repeat."""
    every = {"apiVersion": {"type": "string"}, "kind": {"type": "string"}, "metadata": {"type": "object"}}
    return {**schema, "properties": {**every, **schema["properties"]}}


def _closed(schema: Any) -> Any:
    """A schema that refuses unknown fields: the API server drops them without a word."""
    if isinstance(schema, list):
        return [_closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {key: _closed(value) for key, value in schema.items()}
    preserves = schema.get("x-kubernetes-preserve-unknown-fields") or "additionalProperties" in schema
    if isinstance(schema.get("properties"), dict) and schema.get("type") == "object" and not preserves:
        closed["additionalProperties"] = False
    return closed
