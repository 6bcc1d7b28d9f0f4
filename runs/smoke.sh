#!/usr/bin/env bash
# Every step of reproduce.sh in minutes, with sizes that teach nothing.
#
#   runs/smoke.sh [OUT]     default: out/smoke
set -euo pipefail
SIZE=tiny exec "$(dirname "$0")/reproduce.sh" "${1:-out/smoke}"
