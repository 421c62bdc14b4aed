"""How much of this robot's memory, processor and bandwidth the others can take.

Whatever a message of another robot can fill has its bound here, with where it comes from.
"""

MOST_ROBOTS = 64
"""Robots of which anything is kept where no team list says more.

A replica sums over its robots for each voxel that it hears, and 32 robots already tell half of what
one core can hear (docs/team.md).
"""

MOST_MISSED = 1 << 14
"""Missed blocks of one contribution that are remembered.

As many as two messages of the usual 60 kB name twice over; what is missed beyond that the next
comparison of whole contributions finds.
"""

MOST_TRIES = 8
"""Times that a missed block is asked for.

With a fifth of all requests and answers lost, 3 of 10^4 blocks stay missed, and are found again by
the next comparison. 8 requests of 12 bytes for a row of 16 bytes: a digest costs six times its
bytes.
"""

MISSED_FOR = 30.0
"""Time for which a block is missed [s].

Well above the eight tries at the default request timeout; who has died meanwhile is not asked for
ever.
"""

MOST_WANTED = 32
"""Questions of one robot that wait for their answer."""

MOST_BLOCKS_TAKEN_BACK = 1 << 14
"""Blocks that others hold of an earlier start, and that are taken back after the recovery.

Each takes 2.6 kB, so 43 MB. What more they hold stays with them; it was true when it was told.
"""

TAKEN_BACK_SHARE = 0.02
"""Part of the memory limit for these blocks, where that is less: anybody may hand back anything."""

MOST_RECOVERED = 1 << 20
"""Voxels that others know of this robot and that wait to be put into its map; 40 MB."""

TALK_SHARE = 0.15
"""Part of the bandwidth that each of these may take: digests of what this robot told, digests that
others ask for, and requests. The rest is left for the map itself, whatever the others say."""

GUESTS_MOST, BORROWED_MOST, ROOM_AFTER = 0.9, 0.75, 0.6
"""Parts of the memory limit: for which others' contributions leave room, and which they leave.

Others tell into the shared map until 0.9 of the limit is used, so that what this robot tells always
fits; beyond an equal share only until 0.75 is used, so that who needs less than its share gets it;
and where there is no room, what informs least is dropped until 0.6 is used.
"""

ROOM_PERIOD = 60.0
"""Time between two such droppings [s], as the sum over the robots is made again each time."""
