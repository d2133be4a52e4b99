#!/usr/bin/env bash
# start.sh [WORKERS]: a scheduler and workers on this machine that outlive a run; Ctrl-C stops them.
# Then, in another terminal:  yesnt run SHOT --cluster tcp://127.0.0.1:8786
set -euo pipefail
workers=${1:-2}
export OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
export DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES=0   # the driver counts deaths itself
dask scheduler --host 127.0.0.1 --port 8786 --dashboard-address 127.0.0.1:8787 &
scheduler=$!
trap 'kill $scheduler' EXIT
dask worker tcp://127.0.0.1:8786 --host 127.0.0.1 --nworkers "$workers" --nthreads 1 --no-dashboard
