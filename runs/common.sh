# Sourced by reproduce.sh and measure.sh, which set out, results, episodes, python and here.

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
