#!/usr/bin/env bash
# start.sh HOST...: a scheduler here and one worker on each host (name a host twice for two); Ctrl-C stops them.
# Then, in another terminal:  yesnt run SHOT --cluster tcp://127.0.0.1:8786
# Every port listens on 127.0.0.1 only and travels inside SSH: who may log in may run code, and nobody else.
# Each host has this checkout (with its .venv) and sees the shot and its output folder, all under the same paths as here.
# PORT, PYTHON (here), REMOTE_ROOT and REMOTE_PYTHON (on the hosts) may be set; worker number i uses port PORT+i.
set -euo pipefail
[ $# -ge 1 ] || { sed -n '2,6s/^# //p' "$0" >&2; exit 2; }
root=$(cd "$(dirname "$0")/../.." && pwd)
port=${PORT:-8786} python=${PYTHON:-$root/.venv/bin/python}
there=${REMOTE_ROOT:-$root}
remote=${REMOTE_PYTHON:-$there/.venv/bin/python}
export DASK_CONFIG=$root/deploy/dask.yaml
"$python" -m distributed.cli.dask_scheduler --host 127.0.0.1 --port "$port" --dashboard-address 127.0.0.1:0 &
trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
i=0
for host in "$@"; do
  i=$((i + 1))
  mine=$((port + i))
  # -R: the worker reaches the scheduler; -L: the scheduler reaches the worker; -tt: the worker ends with this script.
  ssh -tt -o ExitOnForwardFailure=yes -R "127.0.0.1:$port:127.0.0.1:$port" -L "127.0.0.1:$mine:127.0.0.1:$mine" "$host" \
    "cd '$there' && DASK_CONFIG=deploy/dask.yaml OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1" \
    "NUMBA_NUM_THREADS=1 exec '$remote' -m distributed.cli.dask_worker tcp://127.0.0.1:$port --host 127.0.0.1" \
    "--worker-port $mine --nworkers 1 --nthreads 1 --no-dashboard" < /dev/null &
done
wait -n   # the end of any part ends all
