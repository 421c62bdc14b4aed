"""Ten bytes for a Gaussian that is as uncertain along its normal as across it.

Where the standard deviation along the normal is larger than that of a point which may lie anywhere
in the voxel, an observation is isotropic: one number for its information and its mean say all
(`infomap_ros.mapping.scans.observation`). Sums of such observations stay so. A code holds

- the information [1/m^2]: 6 bits exponent, 18 bits mantissa, between 2^-16 and 2^46;
- the mean relative to the voxel's centre: 17 bits each for x, y and z, in steps of 2^(e - 36) m
  with 5 bits for e, so that a step is 2^-36 m or at most 2^-15 of the largest of the three.

Both are rounded at every merge, by at most 2^-19 and 2^-16. Rounding halts the growth of the
information after a quarter of a million scans of equal weight, that of the mean after twenty
thousand. Encoding what was decoded gives the same code.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel

CODE_BYTES = 10

_MANTISSA_BITS, _LEAST_EXPONENT = 18, -16
_MANTISSA_ONE = 1 << _MANTISSA_BITS
_LARGEST_CODE = (63 << _MANTISSA_BITS) - 1
_COMPONENT_BITS, _LARGEST_COMPONENT = 17, 65535
_COMPONENT_MASK = (1 << _COMPONENT_BITS) - 1
_LEAST_STEP, _STEP_EXPONENTS = -36, 32
_LOW_BITS = 13

_STEPS = np.ldexp(1.0, np.arange(_STEP_EXPONENTS) + _LEAST_STEP)
_INVERSE_STEPS = 1.0 / _STEPS
_SCALES = np.ldexp(1.0, np.arange(64) + _LEAST_EXPONENT - 1 - _MANTISSA_BITS)
_LEAST, _MOST = math.ldexp(1.0, _LEAST_EXPONENT), math.ldexp(1.0, 46)
_FARTHEST = _LARGEST_COMPONENT * float(_STEPS[-1])


@kernel
def is_isotropic(information: Any) -> bool:
    """Whether information, shape (9,), can be told by a code."""
    xx = information[0]
    if not (information[3] == xx and information[5] == xx and _LEAST <= xx < _MOST):
        return False
    if information[1] != 0.0 or information[2] != 0.0 or information[4] != 0.0:
        return False
    farthest = max(abs(information[6]), max(abs(information[7]), abs(information[8])))
    return bool(farthest < _FARTHEST * xx)


@kernel
def _exponent(value: float) -> Any:
    """Exponent e of a number m * 2^e with 0.5 <= m < 1; of 0 something small."""
    return ((np.float64(value).view(np.int64) >> 52) & 0x7FF) - 1022


@kernel
def encode(weight: float, x: float, y: float, z: float) -> tuple[Any, Any]:
    """Code of an isotropic Gaussian, as 64 and 16 bits.

    Args:
        weight: information [1/m^2], saturates.
        x: mean relative to the voxel's centre [m], likewise y and z.
        y: see x.
        z: see x.
    """
    bits = np.float64(weight).view(np.int64) & ((1 << 52) - 1)
    code = (bits + (1 << (51 - _MANTISSA_BITS))) >> (52 - _MANTISSA_BITS)
    code += (_exponent(weight) - _LEAST_EXPONENT) << _MANTISSA_BITS
    code = min(code, np.int64(_LARGEST_CODE))
    largest = max(abs(x), max(abs(y), abs(z)))
    step = min(max(_exponent(largest) - 16 - _LEAST_STEP, 0), _STEP_EXPONENTS - 1)
    if largest >= (_LARGEST_COMPONENT + 0.5) * _STEPS[step] and step < _STEP_EXPONENTS - 1:
        step += 1
    scale = _INVERSE_STEPS[step]
    a, b, c = _component(x * scale), _component(y * scale), _component(z * scale)
    word = a | (b << _COMPONENT_BITS) | (c << (2 * _COMPONENT_BITS))
    word |= (code & ((1 << _LOW_BITS) - 1)) << (3 * _COMPONENT_BITS)
    return np.uint64(word), np.uint16((code >> _LOW_BITS) | (step << 11))


@kernel
def _component(steps: float) -> Any:
    """A component of the mean, in steps, as an unsigned field."""
    bounded = min(max(math.floor(steps + 0.5), -_LARGEST_COMPONENT), _LARGEST_COMPONENT)
    return np.int64(bounded) + _LARGEST_COMPONENT


@kernel
def decode(word: Any, tail: Any) -> tuple[float, float, float, float]:
    """Information [1/m^2] and mean [m] of a code; information 0 of an empty one."""
    bits, rest = np.int64(word & np.uint64(0x7FFFFFFFFFFFFFFF)), np.int64(tail)
    low = np.int64(word >> np.uint64(3 * _COMPONENT_BITS))
    code = low | ((rest & 0x7FF) << _LOW_BITS)
    if code == 0:
        return 0.0, 0.0, 0.0, 0.0
    mantissa = (code & (_MANTISSA_ONE - 1)) + _MANTISSA_ONE
    weight = mantissa * _SCALES[code >> _MANTISSA_BITS]
    step = _STEPS[rest >> 11]
    x = (bits & _COMPONENT_MASK) - _LARGEST_COMPONENT
    y = ((bits >> _COMPONENT_BITS) & _COMPONENT_MASK) - _LARGEST_COMPONENT
    z = ((bits >> (2 * _COMPONENT_BITS)) & _COMPONENT_MASK) - _LARGEST_COMPONENT
    return weight, x * step, y * step, z * step


@kernel
def decode_information(word: Any, tail: Any, information: Any) -> None:
    """Information of a code, shape (9,), float32."""
    weight, x, y, z = decode(word, tail)
    information[0], information[1], information[2] = weight, 0.0, 0.0
    information[3], information[4], information[5] = weight, 0.0, weight
    information[6], information[7], information[8] = weight * x, weight * y, weight * z


@kernel
def encode_information(information: Any) -> tuple[Any, Any]:
    """Code of isotropic information, shape (9,)."""
    weight = np.float64(information[0])
    share = 1.0 / weight
    return encode(weight, information[6] * share, information[7] * share, information[8] * share)
