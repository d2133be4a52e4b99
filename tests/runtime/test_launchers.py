"""Launchers: profiles, certificates, scripts, and the loop that replaces lost workers; nothing is started here."""

from __future__ import annotations

import os
import re
import ssl
import stat
import subprocess
import sys
import time
from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
import yaml
from cryptography import x509
from distributed import Client

from yesnt.core.errors import ClusterLostError, MissingPartError, UsageError, YesntError
from yesnt.runtime.cluster import drain
from yesnt.runtime.cluster.open_cluster import open_cluster, tunnel_to
from yesnt.runtime.launchers import allocation, slurm, slurm_commands, top_up
from yesnt.runtime.launchers.certificates import Certificate, CertificateFiles, certificate_files, make_certificate
from yesnt.runtime.launchers.local import LocalLauncher
from yesnt.runtime.launchers.processes import Processes, shell_words
from yesnt.runtime.launchers.profile import MODELS, Slurm, seconds_of
from yesnt.runtime.launchers.read_profile import KINDS, parse_profile, read_profile
from yesnt.runtime.launchers.scheduler import dashboard_address, scheduler_here
from yesnt.runtime.launchers.spec import ClusterSpec, read_cluster
from yesnt.runtime.launchers.started import numbered_groups
from yesnt.runtime.launchers.table import LAUNCHERS, check_cluster, launcher_of
from yesnt.runtime.launchers.top_up import FAILED_STARTS, TopUp
from yesnt.runtime.launchers.worker_command import WorkerGroup

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")  # Dask closes sockets of ended workers late

SLURM = {"kind": "slurm", "workers": "3", "memory": "2GiB", "walltime": "01:00:00", "partition": "cpu"}
SSH = {"kind": "ssh", "hosts": {"node01": "2"}}


def written(folder: Path, **keys: object) -> str:
    path = folder / "farm.yaml"
    path.write_text(yaml.safe_dump(keys))
    return str(path)


# --- profiles


def test_every_kind_has_a_model_and_a_launcher() -> None:
    assert set(KINDS) == set(MODELS) == set(LAUNCHERS)


def test_a_profile_is_read_as_it_stands(tmp_path: Path) -> None:
    (tmp_path / "farm.yaml").write_text("kind: slurm\nwalltime: 12:30:00\nmemory: 8GiB\nsetup: [module load x]\n")
    spec = read_cluster(str(tmp_path / "farm.yaml"))
    assert isinstance(spec.profile, Slurm)
    assert spec.profile.walltime == 12 * 3600 + 1800, "YAML 1.1 reads 12:30:00 as a number in base 60"
    assert (spec.kind, spec.workers, int(spec.profile.memory)) == ("slurm", 2, 8 << 30)
    assert read_cluster(str(tmp_path / "farm.yaml"), workers=7).workers == 7


def test_a_site_profile_is_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("YESNT_CLUSTERS", str(tmp_path))
    written(tmp_path, **SLURM)
    assert read_cluster("farm").workers == 3
    with pytest.raises(UsageError, match="No cluster of the kind 'frm'"):
        read_cluster("frm")
    with pytest.raises(UsageError, match=r"'ssh' needs a profile.*ssh\.yaml"):
        read_cluster("ssh")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({**SLURM, "partion": "x"}, r"Unknown key 'partion' in the cluster profile.*did you mean 'partition'"),
        ({**SLURM, "gpu": {"typ": "a100"}}, r"Unknown key 'gpu.typ'.*did you mean 'type'"),
        ({**SLURM, "hosts": {}}, r"Unknown key 'hosts'"),
        ({"kind": "ssh"}, r"The key 'hosts' of the cluster profile is absent"),
        ({"kind": "slrm"}, r"names no kind of cluster.*one of local, attach, ssh, slurm, kubernetes"),
        ({**SLURM, "walltime": "30"}, r"'walltime'.*'30' is no duration; write 90s, 30m, 4h"),
        ({**SLURM, "drain": "2h"}, r"`drain` is as long as `walltime`"),
        ({**SLURM, "mode": "allocation", "gpu": {}}, r"`mode: allocation` has no GPU pool"),
        ({**SLURM, "interface": "ib0", "host": "10.0.0.1"}, r"`interface` and `host` exclude one another"),
        ({**SLURM, "options": ["qos=high"]}, r"The value of 'options.0'"),
        ({**SLURM, "partition": ""}, r"The value of 'partition'"),
    ],
)
def test_what_a_profile_may_not_say(keys: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_profile(keys, "farm.yaml")


def test_a_profile_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"profile is missing.*gone\.yaml"):
        read_profile(tmp_path / "gone.yaml")
    (tmp_path / "bad.yaml").write_text("kind: [")
    with pytest.raises(UsageError, match="cannot be read"):
        read_profile(tmp_path / "bad.yaml")


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90), ("30m", 1800), ("4h", 14400), ("04:00:00", 14400), ("1-12:00:00", 129600)]
)
def test_durations(text: str, seconds: int) -> None:
    assert seconds_of(text) == seconds


def test_hosts_say_how_many_workers_there_are(tmp_path: Path) -> None:
    path = written(tmp_path, kind="ssh", hosts={"a": 2, "b": 3})
    assert read_cluster(path).workers == 5
    with pytest.raises(UsageError, match=r"hosts of an SSH profile say"):
        read_cluster(path, workers=4)


# --- safety and resources


def test_plain_tcp_to_another_machine_is_accepted_on_request_only() -> None:
    with pytest.raises(UsageError, match=r"must use TLS.*--insecure accepts the risk"):
        launcher_of(read_cluster("tcp://10.0.0.1:8786")).check()
    launcher_of(read_cluster("tcp://10.0.0.1:8786", insecure=True)).check()
    launcher_of(read_cluster("tcp://127.0.0.1:8786")).check()


def test_certificates_of_a_profile_must_be_there(tmp_path: Path) -> None:
    path = written(tmp_path, kind="attach", address="tls://host:8786", ca_file="ca.pem")
    with pytest.raises(UsageError, match=rf"certificate of the cluster profile is missing.*{tmp_path}/ca.pem"):
        launcher_of(read_cluster(path)).check()


def test_a_gpu_job_is_refused_where_no_worker_has_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slurm, "require_command", lambda name: None)
    without = ClusterSpec("slurm", profile=parse_profile(SLURM, "x"))
    with pytest.raises(UsageError, match=r"made for a GPU, and the cluster has no GPU workers.*decompose_on: cpu"):
        check_cluster(without.of_job(True, None))
    check_cluster(without.of_job(False, None))
    slow = ClusterSpec("slurm", profile=parse_profile({**SLURM, "decompose_on": "cpu"}, "x"))
    assert not slow.of_job(True, None).gpu
    check_cluster(slow.of_job(True, None))
    check_cluster(ClusterSpec("slurm", profile=parse_profile({**SLURM, "gpu": {}}, "x")).of_job(True, None))


def test_this_machine_must_submit_to_slurm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(UsageError, match="The command sbatch is not on this machine"):
        check_cluster(read_cluster("slurm"))
    monkeypatch.delenv("SLURM_JOB_ID", raising=False)
    with pytest.raises(UsageError, match=r"not inside a Slurm job.*yesnt submit"):
        check_cluster(ClusterSpec("slurm", profile=parse_profile({**SLURM, "mode": "allocation"}, "x")))


def test_a_package_that_is_absent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dask_jobqueue.slurm", None)
    with pytest.raises(MissingPartError, match=r"yesnt\[slurm\]"):
        slurm_commands.job_class()


def test_dask_jobqueue_does_not_take_ctrl_c_over() -> None:
    code = (
        "import signal; before = signal.getsignal(signal.SIGINT)\n"
        "from yesnt.runtime.launchers.slurm_commands import job_class; job_class()\n"
        "import sys; assert 'dask_jobqueue.runner' in sys.modules\n"
        "assert signal.getsignal(signal.SIGINT) is before"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# --- certificates


def test_certificates_are_private_and_go_with_the_run(tmp_path: Path) -> None:
    dead = subprocess.Popen(["true"])
    dead.wait()
    with certificate_files(make_certificate(), tmp_path) as files:
        folder = files.key.parent
        left = folder.rename(folder.with_name(folder.name.rsplit("-", 2)[0] + f"-{dead.pid}-x"))
    assert left.exists(), "a driver that was killed leaves its folder"
    with certificate_files(make_certificate(), tmp_path) as files:
        assert not left.exists()
        for path, mode in ((files.key, 0o600), (files.certificate, 0o600), (files.key.parent, 0o700)):
            assert stat.S_IMODE(path.stat().st_mode) == mode
    assert list(tmp_path.iterdir()) == []


def test_a_certificate_serves_both_sides_and_survives_a_late_clock() -> None:
    made, other = make_certificate(), make_certificate()
    parsed = x509.load_pem_x509_certificate(made.certificate.encode())
    assert parsed.not_valid_before_utc.timestamp() < time.time() - 86400
    server, client = ("get_listen_args", "get_connection_args")
    contexts = {
        who: getattr(whose.security(), kind)(role)["ssl_context"]
        for who, whose, kind, role in (
            ("scheduler", made, server, "scheduler"), ("worker", made, client, "worker"),
            ("alien", other, client, "worker"),
        )
    }  # fmt: skip
    assert _shake_hands(contexts["worker"], contexts["scheduler"])
    with pytest.raises(ssl.SSLCertVerificationError):
        _shake_hands(contexts["alien"], contexts["scheduler"])


def _shake_hands(client: ssl.SSLContext, server: ssl.SSLContext) -> bool:
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [client.wrap_bio(to_client, to_server), server.wrap_bio(to_server, to_client, server_side=True)]
    for _ in range(4):
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
    return ends[0].version() is not None and ends[1].getpeercert(True) is not None


# --- scripts

FILES = CertificateFiles(Path("/a b/c.pem"), Path("/a b/k.pem"))


def job_script(tmp_path: Path, pool: str = "CPU", **keys: object) -> str:
    profile = parse_profile({**SLURM, **keys}, "x")
    assert isinstance(profile, Slurm)
    jobs = slurm._Jobs(profile, profile.gpu if pool == "GPU" else None, "tls://h:1", FILES, tmp_path / "l g", "yesnt-1")
    text = jobs.script(WorkerGroup(f"{pool.lower()}-0.1", pool, 2, 1 << 30))
    subprocess.run(["bash", "-n"], input=text, text=True, check=True)
    return text


def test_a_job_asks_for_what_its_workers_need(tmp_path: Path) -> None:
    text = job_script(
        tmp_path, account="show", options=["--qos=high"], setup=["module load x"], environment={"A": "1 2"}
    )
    for line in (
        "#SBATCH -p cpu", "#SBATCH -A show", "#SBATCH --cpus-per-task=2", "#SBATCH --mem=2560M", "#SBATCH -t 01:00:00",
        "#SBATCH --qos=high", f'#SBATCH --error="{tmp_path}/l g/yesnt-1-%j.err"', "export A='1 2'", "module load x",
        f"export {drain.DRAIN_AT}=$(( $(date +%s) + 3300 - RANDOM % 60 ))",
    ):  # fmt: skip
        assert line in text.splitlines(), line
    command = text.splitlines()[-1]
    for part in (
        "-m yesnt.runtime.cluster.worker tls://h:1",
        "--resources CPU=1",
        "--nworkers 2",
        "--tls-key '/a b/k.pem'",
    ):
        assert part in command
    assert "--lifetime" not in command, "Dask's lifetime ends a worker while its task runs"


def test_a_gpu_job_has_a_gpu(tmp_path: Path) -> None:
    text = job_script(tmp_path, "GPU", gpu={"type": "a100", "partition": "gpu", "walltime": "2h"})
    for line in ("#SBATCH -p gpu", "#SBATCH --gres=gpu:a100:1", "#SBATCH -t 02:00:00"):
        assert line in text.splitlines()
    assert "--resources GPU=1" in text


def test_an_allocation_holds_driver_and_workers(tmp_path: Path) -> None:
    spec = ClusterSpec("slurm", 3, profile=parse_profile({**SLURM, "mode": "allocation"}, "x"))
    text = allocation.submission_script(spec, ["python", "-m", "yesnt", "run", "a b"], tmp_path / "driver.log")
    subprocess.run(["bash", "-n"], input=text, text=True, check=True)
    for line in ("#SBATCH --ntasks=4", "#SBATCH --mem-per-cpu=2560M", "#SBATCH --requeue", "python -m yesnt run 'a b'"):
        assert line in text.splitlines()
    jobs = ClusterSpec("slurm", 3, profile=parse_profile(SLURM, "x"))
    assert "#SBATCH --ntasks=1" in allocation.submission_script(jobs, ["x"], tmp_path / "l").splitlines()


@pytest.mark.parametrize(
    ("status", "late", "requeued"), [(75, True, True), (75, False, False), (1, True, False), (0, True, False)]
)
def test_a_driver_is_requeued_only_when_its_time_is_over(
    tmp_path: Path, status: int, late: bool, requeued: bool
) -> None:
    spec = ClusterSpec("slurm", 1, profile=parse_profile({"kind": "slurm", "walltime": "30m"}, "x"))
    run = ["bash", "-c", f"exit {status}"]
    text = allocation.submission_script(spec, run, tmp_path / "log")
    text = text.replace("$(( $(date +%s) + ", "$(( $(date +%s) - " if late else "$(( $(date +%s) + ")
    calls = 'scontrol() { echo "$@"; }; SLURM_JOB_ID=5\n'
    done = subprocess.run(["bash"], input=calls + text, text=True, capture_output=True)
    assert (done.returncode, done.stdout) == (status, "requeue 5\n" if requeued else "")


def test_a_job_that_submits_jobs_does_not_hand_its_own_options_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sbatch").write_text("#!/bin/sh\necho ${SLURM_CONF}:${SLURM_MEM_PER_CPU}\n")
    (tmp_path / "sbatch").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("SLURM_MEM_PER_CPU", "1024")
    monkeypatch.setenv("SLURM_CONF", "conf")
    assert slurm_commands.submit("", tmp_path) == "conf:"


# --- topping up


class Farm:
    """A source whose groups end when the test says so."""

    def __init__(self, refuses: str = "", dies: bool = False) -> None:
        self.running: set[str] = set()
        self.started: list[str] = []
        self.refuses, self.dies, self.silent, self.suffix = refuses, dies, False, ""

    def start(self, group: WorkerGroup) -> str:
        if self.refuses:
            raise UsageError(self.refuses)
        self.started.append(group.name)
        if not self.dies:
            self.running.add(group.name)
        return group.name

    def alive(self, tokens: Collection[str]) -> set[str] | None:
        return None if self.silent else self.running & set(tokens)

    def stop(self, tokens: Collection[str]) -> None:
        self.running -= set(tokens)

    def log_of(self, token: str) -> str:
        return "no module named yesnt"

    @property
    def ever(self) -> set[str]:
        return {f"{name}{self.suffix}" for name in self.started if not self.dies}

    def now(self) -> set[str]:
        return {f"{name}{self.suffix}" for name in self.running}


def topped(farm: Farm, tmp_path: Path, **options: float) -> TopUp[str]:
    groups = [(group, farm) for group in numbered_groups("CPU", 2, 1, 1 << 30)]
    return TopUp(groups, farm, tmp_path / "log", **options)


def test_a_group_that_ends_is_replaced_under_a_new_name(tmp_path: Path) -> None:
    farm = Farm()
    top = topped(farm, tmp_path)
    top.step(0.0)
    top.step(5.0)
    assert farm.started == ["cpu-0.1", "cpu-1.1"], "what runs is left alone"
    farm.running.discard("cpu-0.1")
    top.step(10.0)
    assert farm.running == {"cpu-0.2", "cpu-1.1"}
    assert "cpu-0.1 has ended" in (tmp_path / "log").read_text()
    top.stop()
    assert farm.running == set()


def test_a_farm_that_does_not_answer_loses_no_worker(tmp_path: Path) -> None:
    farm = Farm()
    top = topped(farm, tmp_path)
    top.step(0.0)
    farm.silent = True
    top.step(5.0)
    assert len(farm.started) == 2


@pytest.mark.parametrize(
    ("farm", "why"),
    [(Farm(dies=True), "no module named yesnt"), (Farm(refuses="no such partition"), "no such partition")],
)
def test_workers_that_never_start_end_the_run_with_the_reason(tmp_path: Path, farm: Farm, why: str) -> None:
    lost: list[int] = []
    groups = [(group, farm) for group in numbered_groups("CPU", 1, 1, 1 << 30)]
    top = TopUp(groups, farm, tmp_path / "log", lambda: lost.append(1))
    for now in range(0, 200, 5):
        top.step(float(now))
    problem = top.problem()
    assert isinstance(problem, ClusterLostError)
    assert f"{FAILED_STARTS} times in a row: {why}" in str(problem)
    assert lost == [1]


def test_one_bad_host_does_not_end_a_run_that_others_carry(tmp_path: Path) -> None:
    good, bad = Farm(), Farm(dies=True)
    groups = numbered_groups("CPU", 2, 1, 1 << 30)
    top: TopUp[str] = TopUp([(groups[0], good), (groups[1], bad)], good, tmp_path / "log")
    for now in range(0, 300, 5):
        top.step(float(now))
    assert top.problem() is None
    assert 10 < len(bad.started) < 20, "it is tried again at leisure"


def test_processes_of_one_job_count_as_joined(tmp_path: Path) -> None:
    farm = Farm()
    farm.suffix = "-3"
    top = topped(farm, tmp_path)
    for now in range(0, 100, 5):
        top.step(float(now))
        farm.running.clear()
    assert len(farm.started) == 2 * 20, "each is replaced at once: its workers had joined"


def test_nothing_is_started_when_the_time_is_over(tmp_path: Path) -> None:
    farm = Farm()
    top = topped(farm, tmp_path, ends_at=12.0)
    top.step(0.0)
    farm.running.clear()
    top.step(13.0)
    assert len(farm.started) == 2
    assert "time of the driver's own job is over" in str(top.problem())
    slow = topped(Farm(), tmp_path, ends_at=12.0)
    slow.step(0.0)
    slow.step(13.0)
    assert slow.problem() is None, "workers finish what they do"
    slow.step(13.0 + top_up.GRACE_SECONDS)
    assert isinstance(slow.problem(), YesntError)


def test_processes_are_started_watched_and_ended(tmp_path: Path) -> None:
    source = Processes(
        lambda group: shell_words(["export WORD=hello"], ["sh", "-c", "echo $WORD; read x; echo $x; cat"]),
        tmp_path,
        "secret",
    )
    process = source.start(WorkerGroup("a.1", "CPU", 1, 1))
    assert source.alive([process]) == [process]
    deadline = time.monotonic() + 10
    while "secret" not in source.log_of(process) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert source.log_of(process) == f"hello | secret ({tmp_path}/a.1.log)"
    source.stop([process])
    assert source.alive([process]) == []
    assert process.returncode == 0, "it ended by itself when its input was closed"


# --- draining


class _Worker:
    """What draining uses of Dask's worker."""

    def __init__(self, busy: int) -> None:
        self.status, self.calls, self._busy = None, [], busy
        self.state = self

    @property
    def all_running_tasks(self) -> set[int]:
        self._busy -= 1
        self.calls.append("busy" if self._busy > 0 else "idle")
        return {1} if self._busy > 0 else set()

    async def close_gracefully(self, restart: bool, reason: str) -> None:
        self.calls.append("closed")
        assert restart is False
        assert "time" in reason


def test_a_worker_finishes_its_task_before_it_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    import asyncio

    from distributed.core import Status

    monkeypatch.setattr(drain, "POLL_SECONDS", 0.0)
    monkeypatch.setattr(drain, "FETCH_SECONDS", 0.0)
    worker = _Worker(3)
    asyncio.run(drain.drain(worker))
    assert worker.status == Status.paused
    assert worker.calls == ["busy", "busy", "idle", "closed"]


def test_the_certificate_is_a_pair() -> None:
    made = make_certificate()
    assert isinstance(made, Certificate)
    assert "PRIVATE KEY" in made.key
    assert "CERTIFICATE" in made.certificate


# --- connections


def test_a_running_scheduler_is_reached_with_the_certificates_of_a_profile(tmp_path: Path) -> None:
    made = make_certificate()
    with certificate_files(made, tmp_path) as files, scheduler_here(made, "lo", None) as cluster:
        path = written(
            tmp_path, kind="attach", address=cluster.scheduler_address, ca_file=str(files.certificate),
            cert_file=str(files.certificate), key_file=str(files.key),
        )  # fmt: skip
        with open_cluster(read_cluster(path)) as client:
            assert client.run_on_scheduler(lambda: 5) == 5
        stranger = read_cluster(cluster.scheduler_address)
        with pytest.raises(UsageError, match=r"no certificate for a connection with TLS.*deploy/attach\.yaml"):
            check_cluster(stranger)
        assert dashboard_address(cluster).startswith("http://127.0.0.1:")


def test_a_tunnel_is_for_the_dashboards_port() -> None:
    assert re.fullmatch(r"ssh -N -L 87:127\.0\.0\.1:87 \S+@\S+", tunnel_to("http://127.0.0.1:87/status"))
    assert tunnel_to("") == ""


def test_an_interface_that_is_not_there_is_named() -> None:
    with pytest.raises(UsageError, match=r"scheduler cannot listen.*keys interface and host"):
        scheduler_here(make_certificate(), "nic9", None).__enter__()


FAKE_SSH = """#!/bin/sh
# stands in for ssh: drops options and host, and hands the rest to a shell, as sshd does
while [ "${1#-}" != "$1" ]; do shift 2; done
shift; exec sh -c "$*"
"""


def test_workers_over_ssh_get_the_certificate_and_end_with_the_connection(tmp_path: Path) -> None:
    (tmp_path / "fake-ssh").write_text(FAKE_SSH)
    (tmp_path / "fake-ssh").chmod(0o755)
    path = written(
        tmp_path, kind="ssh", hosts={"node01": 1}, interface="lo", memory="1500MiB",
        command=[str(tmp_path / "fake-ssh"), "-o", "BatchMode=yes"],
        environment={"PYTHONPATH": str(Path(__file__).parents[2]), "WORD": "it's here"},
    )  # fmt: skip
    with open_cluster(read_cluster(path).of_job(False, tmp_path / "run")) as client:
        client.wait_for_workers(1, timeout=90)
        (worker,) = client.scheduler_info(n_workers=-1)["workers"].values()
        assert (worker["name"], worker["resources"], worker["nthreads"]) == ("cpu-0.1", {"CPU": 1.0}, 1)
        assert list(client.run(os.getenv, "WORD").values()) == ["it's here"]
        (number,) = client.run(os.getpid).values()
    deadline = time.monotonic() + 20
    while psutil.pid_exists(number) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not psutil.pid_exists(number)
    log = (tmp_path / "run" / "workers" / "cpu-0.1.log").read_text()
    assert "PRIVATE KEY" not in log


def test_an_ssh_client_that_is_absent_and_a_host_that_is_an_option_are_refused() -> None:
    for keys, message in (
        ({"command": ["no-such-ssh"]}, "SSH client 'no-such-ssh' is not on this machine"),
        ({"command": ["sh"], "hosts": {"-oProxyCommand=x": "1"}}, "looks like an option of ssh"),
    ):
        spec = ClusterSpec("ssh", profile=parse_profile({**SSH, **keys}, "x"))
        with pytest.raises(UsageError, match=message):
            check_cluster(spec)


def test_this_machines_gpus_get_a_process_each(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert LocalLauncher(ClusterSpec(gpu=True)).pools == {"CPU", "GPU"}
    assert LocalLauncher(ClusterSpec(gpu=False)).pools == set()
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    with LocalLauncher(ClusterSpec(workers=1, gpu=True)).open() as running, Client(running.address) as client:
        client.wait_for_workers(3, timeout=60)
        workers = client.scheduler_info(n_workers=-1)["workers"]
        seen = client.run(os.getenv, "CUDA_VISIBLE_DEVICES")
    offered = {seen[address]: worker["resources"] for address, worker in workers.items()}
    assert offered == {"3,5": {"CPU": 1.0}, "3": {"GPU": 1.0}, "5": {"GPU": 1.0}}


def test_plan_refuses_a_gpu_job_for_a_profile_without_gpus(
    tiny_shot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from yesnt.cli.app import plan

    monkeypatch.setattr("yesnt.runtime.session.needs_gpu", lambda shot: True)
    path = written(tmp_path, **SSH, command=["sh"])
    with pytest.raises(UsageError, match=r"made for a GPU, and the cluster has no GPU workers.*section `gpu:`"):
        plan(tiny_shot, cluster=path)
    assert not (tiny_shot.parent / "out" / "run").exists()


def test_evaluation_and_stage_refuse_a_cluster_before_they_work(tmp_path: Path) -> None:
    from yesnt.capture_stage.tools import Tools
    from yesnt.measure.evaluation.run import EvalOptions, _Drive
    from yesnt.runtime.capture_stage_run import CaptureStageContext, run_capture_stage

    with pytest.raises(UsageError, match="'ssh' needs a profile"):
        _Drive(EvalOptions(cluster="ssh"), lambda event: None, ExitStack())
    context = CaptureStageContext(str(tmp_path / "out"), Tools.__new__(Tools))
    with pytest.raises(UsageError, match="must use TLS"):
        run_capture_stage(["objects"], context, True, ClusterSpec("tcp://10.0.0.1:8786"), lambda event: None)
    assert not (tmp_path / "out").exists()
