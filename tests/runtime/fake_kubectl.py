"""Stands in for kubectl, API server, operator and nodes: runs the containers' commands as processes of this machine.

State lies in $FAKE_CLUSTER: `objects.json`, `ports.json`, `pids`, and the secret's files.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

STATE = Path(os.environ["FAKE_CLUSTER"])
PORT, DASHBOARD, TLS_FOLDER = "8786", "8787", "/run/yesnt-tls"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def apply() -> None:
    objects = {item["kind"]: item for item in json.load(sys.stdin)["items"]}
    (STATE / "objects.json").write_text(json.dumps(objects))
    for name, text in objects["Secret"]["stringData"].items():
        (STATE / name).write_text(text)
    ports = {PORT: free_port(), DASHBOARD: free_port()}
    (STATE / "ports.json").write_text(json.dumps(ports))
    cluster = objects["DaskCluster"]
    name, spec = cluster["metadata"]["name"], cluster["spec"]
    start(spec["scheduler"]["spec"], ports, name, {})
    for i in range(spec["worker"]["replicas"]):
        start(spec["worker"]["spec"], ports, name, {"DASK_WORKER_NAME": f"{name}-worker-{i}"})


def start(pod: dict[str, Any], ports: dict[str, int], cluster: str, variables: dict[str, str]) -> None:
    """Starts a pod's container: its command with what Kubernetes and its network would put in."""
    container = pod["containers"][0]
    assert container["volumeMounts"][-1]["mountPath"] == TLS_FOLDER
    replaced = {
        f"{cluster}-scheduler:{PORT}": f"127.0.0.1:{ports[PORT]}", TLS_FOLDER: str(STATE), "0.0.0.0": "127.0.0.1",
        f"127.0.0.1:{DASHBOARD}": f"127.0.0.1:{ports[DASHBOARD]}",
        **{f"$({key})": value for key, value in variables.items()},
    }  # fmt: skip
    words = [str(ports[PORT]) if word == PORT else word for word in container["command"]]
    for old, new in replaced.items():
        words = [word.replace(old, new) for word in words]
    environment = {**os.environ, **{entry["name"]: entry["value"] for entry in container["env"]}, **variables}
    with (STATE / "log").open("a") as log:
        process = subprocess.Popen(words, env=environment, stdout=log, stderr=log, start_new_session=True)
    with (STATE / "pids").open("a") as stream:
        stream.write(f"{process.pid}\n")


def wait() -> int:
    port = json.loads((STATE / "ports.json").read_text())[PORT]
    for _ in range(200):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return 0
        time.sleep(0.1)
    return 1


def port_forward() -> None:
    for there, here in json.loads((STATE / "ports.json").read_text()).items():
        sys.stdout.write(f"Forwarding from 127.0.0.1:{here} -> {there}\n")
        sys.stdout.flush()
    signal.pause()


def delete() -> None:
    for number in (STATE / "pids").read_text().split():
        try:
            os.killpg(int(number), signal.SIGTERM)
        except ProcessLookupError:
            continue
    (STATE / "deleted").write_text(" ".join(sys.argv))


if __name__ == "__main__":
    sys.exit({"apply": apply, "wait": wait, "port-forward": port_forward, "delete": delete}[sys.argv[1]]())
