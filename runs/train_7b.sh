#!/usr/bin/env bash
# CognitiveDrone-7B, the paper's training, on 1 to 8 GPUs of this machine: collect, fine-tune, score.
#
#   runs/train_7b.sh BASE [RUN]
#
# BASE is the folder of the published OpenVLA-7B (see docs/openvla.md), RUN where everything goes (default: out/7b).
# GPUS=4 takes four GPUs instead of all, RECIPE=race another recipe, DATA=flights a data set that is there already.
# SHARD=1 spreads the weights over the GPUs, for cards that cannot hold them. Stopped at any moment, it goes on when it
# is started again.
#
# Not yet run on a GPU: on the tiny configuration, the tests take each of these steps.
set -euo pipefail

base=${1:?"give the folder of OpenVLA-7B: runs/train_7b.sh BASE [RUN]"}
run=${2:-out/7b}
gpus=${GPUS:-$(nvidia-smi --list-gpus | wc -l)}
data=${DATA:-$run/flights}

# 8,062 flights of the expert, as many as in the paper.
if [[ -z ${DATA:-} ]]; then
  cognitivedrone collect --recipe paper --out "$data" --resume
fi

# LoRA of rank 32 on all linear layers, batch 64 by accumulation, rate 5e-4, 4,000 steps.
torchrun --standalone --nproc-per-node "$gpus" -m cognitivedrone train-openvla \
  --base "$base" --data "$data" --out "$run" --recipe "${RECIPE:-paper}" --resume ${SHARD:+--shard}

# 300 tasks of another draw than those of training.
cognitivedrone bench --policy "openvla:$run/merged" --suite open-v1:test --workers 1 --out "$run/bench" --resume
