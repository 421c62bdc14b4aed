"""Why a vehicle may not stand somewhere, in words."""

from __future__ import annotations

from math import degrees

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base import stance as kernels


def outcome_in_words(
    outcome: int, measures: FloatArray, limits: FloatArray, wheels: tuple[str, ...],
    link: str = "the body", place: str = "",
) -> str:  # fmt: skip
    """A short sentence with the figures that decided; empty for a good stance.

    Args:
        outcome: as in `infomap_ros.motion.base.stance`.
        measures: of the stance, shape (MEASURES,).
        limits: as of `VehicleArrays`.
        wheels: names of the wheels.
        link: of the body, where the stance is refused because of what is there.
        place: where in the map that is, in words.
    """
    if outcome == kernels.STANDS:
        return ""
    if outcome in (kernels.UNKNOWN_WHEEL, kernels.OFF_GROUND):
        return _of_wheel(outcome, measures, limits, wheels[int(measures[kernels.CULPRIT])])
    slope, tip = degrees(measures[kernels.SLOPE]), degrees(measures[kernels.TIP])
    step, rough = measures[kernels.STEP], measures[kernels.ROUGHNESS]
    return {
        kernels.OUTSIDE: "outside the mapped terrain",
        kernels.UNKNOWN_BODY: f"unknown ground under the body ({link}){place}",
        kernels.STEEP: f"slope of {slope:.0f} deg, limit {degrees(limits[1]):.0f} deg",
        kernels.STEPPED: f"step of {step:.3f} m under a wheel, limit {limits[2]:.3f} m",
        kernels.ROUGH: f"roughness of {rough:.3f} m under a wheel, limit {limits[3]:.3f} m",
        kernels.TIPS: f"tip-over margin of {tip:.0f} deg, at least "
        f"{degrees(limits[4]):.0f} deg needed",
        kernels.TOUCHES_GROUND: f"{link} touches the ground or an obstacle on it{place} "
        f"({-measures[kernels.CLEARANCE]:.3f} m too low)",
        kernels.TOUCHES_OBSTACLE: f"{link} touches an obstacle{place}",
        kernels.UNSEEN: f"{link} enters space that was never seen{place}",
    }[outcome]


def _of_wheel(outcome: int, measures: FloatArray, limits: FloatArray, wheel: str) -> str:
    if outcome == kernels.UNKNOWN_WHEEL:
        return f"unknown ground under {wheel}"
    misfit = measures[kernels.MISFIT]
    travel = limits[0]
    return (
        f"{wheel} is {misfit:.3f} m off the plane of the wheels, suspension allows {travel:.3f} m"
    )
