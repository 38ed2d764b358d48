#!/bin/bash
# A sweep on a Slurm cluster: a Ray cluster over the nodes of one job, a population on each GPU.
#
#   sbatch docs/sweeps/slurm.sh my_sweep.py /shared/sweeps/my_sweep
#
# The folder must lie on a file system that all nodes share. A job that was requeued, preempted or out of time goes on
# where it was: submit the same line again, or `scontrol requeue JOB`.
#
# Change: the lines below, as `sinfo` and your site's manual say.
#SBATCH --job-name=jaxnav-sweep
#SBATCH --nodes=2
#SBATCH --gpus-per-node=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=16
#SBATCH --mem=64G
#SBATCH --time=24:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%j.log
# Change, if your site asks for them, and take the first # away:
##SBATCH --partition=gpu
##SBATCH --account=project

set -euo pipefail
file=${1:?give the file of the sweep: sbatch slurm.sh FILE DIR}
out=${2:?give a folder that all nodes share: sbatch slurm.sh FILE DIR}

# Change: whatever makes `jaxnav` and `ray` available on every node, of pip install "jaxnav[sweep,cuda]".
# module load cuda
# source /shared/venvs/jaxnav/bin/activate
# Change, if others reach these nodes: who reaches Ray's port runs what they like as you. Once `ray get-auth-token
# --generate`, in a home that all nodes share, and then
# export RAY_AUTH_MODE=token

# This script runs on the first node of the job.
head=$SLURMD_NODENAME
address=$({ hostname --ip-address; hostname --all-ip-addresses; } | tr ' ' '\n' |
  awk '/^[0-9.]+$/ && !/^127\./ && !found { print; found = 1 }')  # Change, if that isn't the fast network.
port=$((20000 + SLURM_JOB_ID % 10000))          # of its own, since another job's Ray may share the node
export RAY_ADDRESS="$address:$port"             # which cluster "auto" means
export SRUN_CPUS_PER_TASK=$SLURM_CPUS_PER_TASK  # srun doesn't take it over from sbatch

trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
srun --nodes=1 --ntasks=1 --nodelist="$head" \
  env -u RAY_ADDRESS ray start --head --node-ip-address="$address" --port="$port" --num-cpus="$SLURM_CPUS_PER_TASK" \
  --disable-usage-stats --block &

for _ in {1..60}; do
  ray status >/dev/null 2>&1 && break
  sleep 2
done
ray status  # says why, if the head isn't there

if ((SLURM_JOB_NUM_NODES > 1)); then
  srun --nodes=$((SLURM_JOB_NUM_NODES - 1)) --ntasks=$((SLURM_JOB_NUM_NODES - 1)) --exclude="$head" \
    env -u RAY_ADDRESS ray start --address="$RAY_ADDRESS" --num-cpus="$SLURM_CPUS_PER_TASK" --block &
fi

options=(--out "$out" --engine ray --address auto)
if [[ -e $out/sweep.json ]]; then
  options+=(--resume)
fi
jaxnav sweep "$file" "${options[@]}"
