#!/usr/bin/env bash
# start.sh [WORKERS]: a scheduler and workers on this machine that outlive a run; Ctrl-C stops them.
# Then, in another terminal:  yesnt run SHOT --cluster tcp://127.0.0.1:8786
# PORT and PYTHON may be set: another port, and the Python that has yesnt (default: the repository's environment).
set -euo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
workers=${1:-2} port=${PORT:-8786} python=${PYTHON:-$root/.venv/bin/python}
export DASK_CONFIG=$root/deploy/dask.yaml   # deaths are counted by the driver, threads pinned, freed pages kept
export OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
"$python" -m distributed.cli.dask_scheduler --host 127.0.0.1 --port "$port" --dashboard-address 127.0.0.1:0 &
scheduler=$!
trap 'kill $scheduler 2>/dev/null || true' EXIT
"$python" -m distributed.cli.dask_worker "tcp://127.0.0.1:$port" --host 127.0.0.1 --nworkers "$workers" --nthreads 1 \
  --no-dashboard
