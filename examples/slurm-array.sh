#!/bin/sh
# Trains the blocks of a scene as an array of jobs, one for each block, and merges them when all are done:
#
#   coseg split --data scenes/house --blocks 3x2 --out blocks
#   array=$(sbatch --parsable --array=0-5 examples/slurm-array.sh)
#   sbatch --dependency=afterok:$array --wrap 'coseg merge --out runs/house runs/*_*'
#
# The scene folder and the blocks must be on a file system that all machines see. Adapt memory, processors and time.
#SBATCH --job-name=coseg-block
#SBATCH --cpus-per-task=8
#SBATCH --mem=16G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -eu
block=$(ls blocks | sed -n "$((SLURM_ARRAY_TASK_ID + 1))p")
run=runs/$block
# SLURM sends a job again after its machine failed. One that ran out of time has to be sent again by hand. Both continue where
# they stopped.
if [ -e "$run/config.toml" ]; then
    exec coseg train --resume "$run"
fi
exec coseg train --data "blocks/$block" --out "$run"
