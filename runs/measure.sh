#!/usr/bin/env bash
# Every figure of the docs that depends on the packaged weights, measured again, the most looked at first.
#
#   runs/measure.sh [OUT] [--only scores|reasoner|missions|audits|speed|seeds]
#
# Hours on two cores; every part, and every suite in it, goes on where it was stopped when it is started again. Everything
# goes to OUT (default: out/measure), then OUT/results/*.json to results/ and from there into the pages. Refuses to start
# where the checkout holds changes that are not committed: a figure names its commit. Before the script: POLICY, REASONER
# and RACE are pilots to measure in place of the packaged ones (runs/reproduce.sh), SIZE=tiny three tasks of each suite,
# KEEP=no leaves results/ as they are.
set -euo pipefail

out=out/measure only=all
while (($#)); do
  case $1 in
    --only) only=$2; shift 2 ;;
    *) out=$1; shift ;;
  esac
done
case $only in all | scores | reasoner | missions | audits | speed | seeds) ;;
  *) echo "--only is $only; it must be scores, reasoner, missions, audits, speed or seeds" >&2; exit 2 ;;
esac
policy=${POLICY:-small} reasoner=${REASONER:-small} race=${RACE:-race} size=${SIZE:-full}
python=${PYTHON:-python3}
here=$(dirname "$0")/..
results=$out/results
if [[ ${KEEP:-yes} == yes ]] && ! git -C "$here" diff --quiet HEAD; then
  echo "the checkout holds changes that are not committed; commit them first, or set KEEP=no" >&2
  exit 2
fi
mkdir -p "$results"

opened=(open-v3:words open-v3:photos)
headline=(open-v1:test open-v1:unseen open-v2:words open-v2:pictures open-v1:hard open-v2:absent open-v2:layouts)
suites=("${headline[@]}" "${opened[@]}" open-v2:test open-v1:track)
wild=(--appearance varied --wind 2) places=(--appearance photo --place kept)
episodes=()
if [[ $size == tiny ]]; then
  suites=(open-v1:test) headline=(open-v1:test) episodes=(--episodes 3)
fi

wanted() { [[ $only == all || $only == "$1" ]]; }

source "$here/runs/common.sh"

fly() { # FOLDER SUITE OPTIONS...
  [[ -e $out/$1/results.json ]] || cognitivedrone bench --suite "open-v3:$2" --out "$out/$1" --resume --clips 0 "${@:3}"
}

r1=(--policy "$policy" --reasoner "$reasoner")

# results/PILOT.json
if wanted scores; then
  for suite in "${suites[@]}"; do bench r1 "$suite" "${r1[@]}"; done
  if [[ $size == full ]]; then
    bench r1 open-v3:wild "${r1[@]}" "${wild[@]}"
    for suite in open-v3:photos open-v2:pictures open-v1:hard; do bench r1 "$suite+far" "${r1[@]}" --look no; done
    bench r1 open-v3:wild+far "${r1[@]}" "${wild[@]}" --look no
  fi
  for suite in "${suites[@]}"; do bench small "$suite" --policy "$policy"; done
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
  if [[ $size == full ]]; then
    bench small open-v3:wild --policy "$policy" "${wild[@]}"
    bench small open-v1:test+varied --policy "$policy" --appearance varied
    bench small open-v1:test+wind --policy "$policy" --wind 0.5
    for suite in open-v3:places open-v1:test; do
      bench small "$suite+places" --policy "$policy" "${places[@]}"
      bench r1 "$suite+places" "${r1[@]}" "${places[@]}"
    done
    bench r1 open-v1:test+guard "${r1[@]}" --guard
    bench oracle open-v1:test+iris --policy oracle --airframe iris
    bench colour_seeker_oracle open-v1:test+varied --policy colour_seeker --reasoner oracle --appearance varied
    for suite in open-v1:track open-v1:race; do
      bench oracle "$suite" --policy oracle
      bench colour_seeker_oracle "$suite" --policy colour_seeker --reasoner oracle
    done
    bench colour_seeker open-v1:race --policy colour_seeker
  fi
fi

# results/reasoner_alone.json
if wanted reasoner; then
  for suite in "${suites[@]}"; do
    answers=$out/reason/${suite//:/-}
    [[ -e $answers/reason.json ]] ||
      cognitivedrone reason --reasoner "$reasoner" --suite "$suite" --out "$answers" --overwrite "${episodes[@]}"
  done
  if [[ $size == full && ! -e $out/reason/open-v3-wild/reason.json ]]; then
    cognitivedrone reason --reasoner "$reasoner" --suite open-v3:wild "${wild[@]}" --out "$out/reason/open-v3-wild" --overwrite
  fi
fi

# results/missions.json, clutter.json, moving.json, gates.json and swaying.json
if wanted missions && [[ $size == full ]]; then
  for suite in missions clutter moving gates swaying; do
    fly "$suite/oracle" "$suite" --policy oracle
    fly "$suite/small_gold" "$suite" --policy "$policy" --reasoner oracle
    fly "$suite/small" "$suite" --policy "$policy"
    fly "$suite/r1" "$suite" "${r1[@]}"
    script=clutter
    [[ $suite == missions ]] && script=missions
    measure "$suite" "$script" "$out/$suite"/{oracle,small_gold,small,r1}
  done
fi

# results/audit_PILOT.json and r1_latency.json
if wanted audits; then
  less=()
  [[ $size == full ]] || less=(--only "mirrored stage")
  cognitivedrone audit "${r1[@]}" --out "$out/audit/r1" "${episodes[@]}" "${less[@]}"
  if [[ $size == full ]]; then
    cognitivedrone audit --policy "$policy" --out "$out/audit/small"
    cognitivedrone audit --policy "$race" --out "$out/audit/race"
    cognitivedrone sweep "${r1[@]}" --suite open-v1:hard --out "$out/scores/r1_latency"
  fi
fi

# What a decision, an answer and a run cost here.
if wanted speed && [[ $size == full ]]; then
  measure inference inference
  measure real_time real_time "${r1[@]}" --seconds 60
  measure mission_end mission_end "${r1[@]}"
  measure first_score first_score "$python"
  measure serving serving
  measure ratios ratios
fi

# results/small_seed_N.json: what the seed of a training changes.
if wanted seeds && [[ $size == full ]]; then
  for seed in 1 2 3; do
    [[ -e $out/seeds/$seed/model.onnx ]] ||
      cognitivedrone train --recipe flight --start "$policy" --seed "$seed" --steps 600 --processes 2 --resume --out "$out/seeds/$seed"
    for suite in open-v1:test open-v1:unseen; do
      bench "small_seed_$seed" "$suite" --policy "small:$out/seeds/$seed/model.onnx"
    done
  done
fi

submitted() { # PILOT NAME
  local runs=()
  for suite in open-v2:words open-v2:pictures open-v1:unseen open-v1:test open-v1:hard; do
    runs+=("$out/scores/$1/${suite//:/-}")
  done
  cognitivedrone submit "${runs[@]}" --name "$2" --by CognitiveDrone --out "$here/leaderboard/$1.json"
}

if [[ ${KEEP:-yes} == yes ]]; then
  if wanted scores && [[ $size == full ]]; then
    submitted r1 "CognitiveDrone-R1 (small)"
    submitted small "CognitiveDrone (small)"
    submitted race "RaceVLA baseline (race)"
  fi
  "$python" "$here/scripts/keep_results.py" "$out" "$results" "$here/results"
  "$python" "$here/scripts/render_tables.py"
fi
