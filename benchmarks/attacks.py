"""Attacks the package as a stranger's files, folders, arguments and messages would, and says what held.

Run: python benchmarks/attacks.py [--only KIND ...] [--messages 2000] [--seed 0] [--out results/attacks.json]

Every attack runs in a folder of its own. It fells the package if it runs code, opens or overwrites what it must not,
gets a false score confirmed, puts markup into a page, ends in a traceback or keeps the program busy. Prints a table;
exit code 1 if anything fell.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import attacks_checkpoints
import attacks_files
import attacks_grounds
import attacks_named
import attacks_submissions
from attack_tools import PROJECT, Attack, outcome

from cognitivedrone.benchmark.measurements import OUT_HELP, keep

OTHERS = ("network_attacks", "hostile_files")
"""Modules whose function `attacks()` has more, each with `kind`, `name` and `run(folder)` as `attack_tools.Attack`."""


def all_attacks(messages: int, seed: int) -> list[Attack]:
    """Every attack; those on a server send so many messages."""
    honest, document = attacks_submissions.honest()
    found = [
        *attacks_named.attacks(document),
        *attacks_submissions.attacks(honest, document),
        *attacks_files.attacks(),
        *attacks_grounds.attacks(),
        *attacks_checkpoints.attacks(),
        Attack("messages to a server", f"{messages} hostile messages", server(messages, seed), limit_s=600),
    ]
    for name in OTHERS:
        if importlib.util.find_spec(name) is None:
            continue
        module: Any = importlib.import_module(name)
        found += [Attack(each.kind, each.name, each.run, limit_s=600) for each in module.attacks()]
    return found


def server(messages: int, seed: int) -> Callable[[Path], str]:
    """Hostile messages to a policy server, by their own program."""

    def run(folder: Path) -> str:
        words = ["fuzz_server.py", "--messages", str(messages), "--seed", str(seed), "--policy", "hover"]
        words[0] = str(PROJECT / "benchmarks" / words[0])
        done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
        return "" if done.returncode == 0 else (done.stdout + done.stderr).strip().rpartition("\n")[2]

    return run


def attacked(attacks: Iterable[Attack], say: Callable[[str], object] = print) -> list[tuple[Attack, str]]:
    """Run the attacks; each with why the package fell, or an empty text."""
    results = []
    for attack in attacks:
        with tempfile.TemporaryDirectory(prefix="attack-") as folder:
            fell = outcome(attack, Path(folder) / "attack")
        results.append((attack, fell))
        if fell:
            say(f"FELL  {attack.kind}: {attack.name[:60]!r}: {fell}")
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND", help="kinds of attacks, by their beginning")
    parser.add_argument("--messages", type=int, default=2000, help="to a server")
    parser.add_argument("--seed", type=int, default=0, help="of those messages")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    attacks = all_attacks(options.messages, options.seed)
    if options.only:
        attacks = [attack for attack in attacks if attack.kind.startswith(tuple(options.only))]
    results = attacked(attacks, lambda line: print(line, flush=True))
    tried = Counter(attack.kind for attack, _ in results)
    fell = Counter(attack.kind for attack, why in results if why)
    rows = [{"kind": kind, "attacks": n, "held": n - fell[kind], "fell": fell[kind]} for kind, n in tried.items()]
    print(f"{'kind':34} attacks   held   fell")
    for row in rows:
        print(f"{row['kind']:34} {row['attacks']:7}{row['held']:7}{row['fell']:7}")
    print(f"{'all':34} {tried.total():7}{tried.total() - fell.total():7}{fell.total():7}")
    keep(options.out, "Attacks on the package, and what held", rows, seed=options.seed)
    sys.exit(1 if fell else 0)


if __name__ == "__main__":
    main()
