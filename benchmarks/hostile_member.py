"""A hostile member in a team of four: the others' map, with it and without it.

    python benchmarks/hostile_member.py --seconds 3600

Prints a table for docs/team.md; exits with 1 where an honest robot's contribution is not the same
everywhere, or not the same as without the liar.
"""

from __future__ import annotations

import argparse

from infomap_ros.studies.team.hostile_member import run


def main() -> int:
    """Run with and without the liar."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="simulated")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    quiet, hostile = (run(arguments.seconds, lies, seed=arguments.seed) for lies in (False, True))
    print("| | without | with the liar |\n| --- | --- | --- |")
    same = [len({tuple(held) for held in each.hashes}) == 1 for each in (quiet, hostile)]
    rows = [
        ("honest maps the same on all three", *("yes" if each else "no" for each in same)),
        ("the same as without the liar", "", "yes" if quiet.hashes == hostile.hashes else "no"),
        ("after the last view [s]", *(f"{each.end:.2f}" for each in (quiet, hostile))),
        ("memory of a replica [MB]", *(f"{each.memory / 1e6:.1f}" for each in (quiet, hostile))),
        ("blocks of the liar that are kept", quiet.liars_blocks, hostile.liars_blocks),
        ("processor, all three [s]", *(f"{each.seconds:.1f}" for each in (quiet, hostile))),
    ]
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    print("told by the liar:", dict(hostile.told))
    print("refused:", dict(hostile.dropped))
    return int(not all(same) or quiet.hashes != hostile.hashes)


if __name__ == "__main__":
    raise SystemExit(main())
