#!/usr/bin/env bash
# The whole system from nothing: data, the small models, every benchmark of the docs, the paper's figure and table.
#
#   runs/reproduce.sh [OUT]          about six hours on two cores; everything goes to OUT (default: out/reproduce)
#   SIZE=tiny runs/reproduce.sh OUT  the same steps in minutes, with sizes that teach nothing: it shows that they work
#
# Stopped at any moment, it goes on when it is started again. Needs the extra `train`. The weights that are shipped come
# out of this script, to the bit on one machine; OUT/manifest.json says recipe, seed, commit and hash of each.
set -euo pipefail

out=${1:-out/reproduce}
size=${SIZE:-full}
processes=${PROCESSES:-2}
python=${PYTHON:-python3}
mkdir -p "$out"

case $size in
  full) sets=(500 2000 8062) short=() episodes=() suites=all ;;
  tiny) sets=(12) short=(--steps 3) episodes=(--episodes 3) suites=one ;;
  *) echo "SIZE is $size; it must be full or tiny" >&2; exit 2 ;;
esac

train() { # NAME RECIPE OPTIONS...
  local name=$1 recipe=$2
  shift 2
  [[ -e $out/$name/done ]] && return
  cognitivedrone train --recipe "$recipe" --out "$out/$name" --processes "$processes" --resume "${short[@]}" "$@"
  touch "$out/$name/done"
}

bench() { # NAME SUITE OPTIONS...
  local name=$1 suite=$2
  shift 2
  cognitivedrone bench --suite "$suite" --out "$out/scores/$name/${suite//:/-}" --resume --clips 0 "${episodes[@]}" "$@"
}

# The pilot: reading panels, flying, language, the reasoner's choice; and the racing baseline without language.
train reader reader
train small small --start "$out/reader/reader.safetensors"
train language language --start "$out/small/checkpoint.safetensors"
train selector selector --start "$out/language/checkpoint.safetensors"
train race race

# What a fixed set of the expert's flights is worth against flights made during training; the paper has 8,062.
for flights in "${sets[@]}"; do
  cognitivedrone collect --recipe paper --episodes "$flights" --out "$out/flights-$flights" --resume
  train "recorded-$flights" small --start "$out/reader/reader.safetensors" --data "$out/flights-$flights"
done

policy=small:$out/language/model.onnx
reasoner=small:$out/selector
race=race:$out/race/model.onnx

# Every suite: held-out ones first.
names=(open-v2:words open-v2:pictures open-v1:unseen open-v1:test open-v2:test open-v2:layouts open-v2:absent open-v1:hard)
[[ $suites == one ]] && names=(open-v1:test)
for suite in "${names[@]}"; do
  bench small "$suite" --policy "$policy"
  bench r1 "$suite" --policy "$policy" --reasoner "$reasoner"
done
bench race open-v1:test --policy "$race"
bench race open-v1:race --policy "$race"
for flights in "${sets[@]}"; do
  bench "recorded-$flights" open-v1:test --policy "small:$out/recorded-$flights/model.onnx"
done

only=()
[[ $size == tiny ]] && only=(--only "mirrored stage")
cognitivedrone audit --policy "$policy" --reasoner "$reasoner" --out "$out/audit" "${episodes[@]}" "${only[@]}"

"$python" "$(dirname "$0")/../scripts/paper_table.py" "$out"
