"""A hostile member in a team of four: the others' maps, with it and without it.

    python benchmarks/hostile_member.py --seconds 3600

Prints a table for docs/team.md; exits with 1 where an honest robot's contribution is not the same
everywhere, or not the same as without the liar, or a replica was above its limit of memory.
"""

from __future__ import annotations

import argparse
import json

from infomap_ros.studies.team.hostile_member import run_with_liar


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=3600.0, help="simulated")
    parser.add_argument("--period", type=float, default=2.0, help="between two views [s]")
    parser.add_argument("--lies", type=float, default=0.5, help="of the liar [MB/s]")
    parser.add_argument("--memory-limit", type=float, default=0.1, help="of a replica [GB]")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    settings = {"period": given.period, "memory_limit": given.memory_limit, "seed": given.seed}
    quiet, hostile = (run_with_liar(given.seconds, lies, **settings) for lies in (0.0, given.lies))
    same = [len(set(each.hashes)) == 1 for each in (quiet, hostile)]
    is_as_without = quiet.hashes == hostile.hashes
    rows: list[tuple[str, object, object]] = [
        ("honest contributions the same on all three", *("yes" if each else "no" for each in same)),
        ("the same as without the liar", "", "yes" if is_as_without else "no"),
        ("time until then, after the last view [s]", f"{quiet.end:.2f}", f"{hostile.end:.2f}"),
        ("largest replica [MB]", f"{quiet.memory / 1e6:.1f}", f"{hostile.memory / 1e6:.1f}"),
        ("blocks of the liar that are kept", quiet.liars_blocks, hostile.liars_blocks),
        ("processor, all three [s]", f"{quiet.seconds:.1f}", f"{hostile.seconds:.1f}"),
    ]
    print("| | without | with the liar |\n| --- | --- | --- |")
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    print(json.dumps({"sent": hostile.sent, "refused": hostile.refused}))
    is_within = hostile.memory <= 1e9 * given.memory_limit
    return 0 if all(same) and is_as_without and is_within else 1


if __name__ == "__main__":
    raise SystemExit(main())
