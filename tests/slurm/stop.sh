#!/usr/bin/env bash
# stop.sh FOLDER: ends the Slurm that start.sh started there, with all of its jobs; munge stays.
set -u
export SLURM_CONF=$1/slurm.conf
scancel --user="$(id -un)" 2> /dev/null
for _ in $(seq 50); do [ -z "$(squeue --noheader 2> /dev/null)" ] && break; sleep 0.2; done
for name in slurmd slurmctld; do
  [ -e "$1/$name.pid" ] && kill "$(cat "$1/$name.pid")" 2> /dev/null
done
true
