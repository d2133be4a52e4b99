#!/usr/bin/env bash
# start.sh FOLDER: starts a private Slurm of one node in FOLDER (needs root and Debian's packages
# slurm-wlm, slurmctld, slurmd, munge) and prints the path of its slurm.conf; stop.sh FOLDER ends it.
#   apt-get install -y --no-install-recommends slurm-wlm slurmctld slurmd slurm-client munge
#   export SLURM_CONF=$(tests/slurm/start.sh /tmp/slurm)
set -euo pipefail
folder=$1
host=$(hostname -s)
cores=$(nproc)
mkdir -p "$folder/state" "$folder/spool" /run/munge
export SLURM_CONF=$folder/slurm.conf
cat > "$SLURM_CONF" <<CONF
ClusterName=yesnt
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
ReturnToService=2
SlurmctldPort=${SLURMCTLD_PORT:-16817}
SlurmdPort=${SLURMD_PORT:-16818}
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
SchedulerParameters=sched_interval=1,batch_sched_delay=0
KillWait=5
GresTypes=gpu
# More processors than there are: several small jobs may run side by side on a small machine.
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=$((cores > 8 ? cores : 8)) RealMemory=16000 Gres=gpu:fake:2
PartitionName=debug Nodes=$host Default=YES State=UP
CONF
for device in /dev/null /dev/zero; do   # stand in for GPUs
  echo "NodeName=$host Name=gpu Type=fake File=$device"
done > "$folder/gres.conf"
chown munge: /run/munge
munge -n > /dev/null 2>&1 || su -s /bin/sh munge -c /usr/sbin/munged
for _ in $(seq 50); do munge -n > /dev/null 2>&1 && break; sleep 0.1; done
slurmctld -f "$SLURM_CONF"
slurmd -f "$SLURM_CONF"
for _ in $(seq 100); do sinfo --noheader --format=%T 2> /dev/null | grep -q idle && break; sleep 0.2; done
sinfo --noheader --format=%T | grep -q idle || {
  tail -n 5 "$folder"/*.log >&2
  "$(dirname "$0")/stop.sh" "$folder"
  exit 1
}
echo "$SLURM_CONF"
