"""The target as a CAD model, found in a range map without a first guess.

Steps: votes of point pairs; registration of the best; the check that refuses what the camera looks
through or what is part of something larger; the other poses that fit as well, as those of a
symmetric model do; refinement with the covariances of the points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.config import ModelTargetConfig
from infomap_ros.localization.target.model_fit import ModelFitter
from infomap_ros.localization.target.model_rivals import PoseComparison
from infomap_ros.localization.target.model_scene import ModelScene
from infomap_ros.localization.target.model_search import Hypothesis, ModelSearch
from infomap_ros.localization.target.model_shape import ModelShape, load_model
from infomap_ros.localization.target.target import RefusalReason, TargetRefusal, TargetSighting

if TYPE_CHECKING:
    from infomap_ros.localization.fiducials.range_view import RangeView

_NAME = "model"
_FINE = 0.02  # spacing of the scene's points, as a share of the diameter
_DENSE = 0.008  # of the model's points for the refinement
_SAME_PLACE = 0.05  # poses nearer than this share of the diameter and
_SAME_OBJECT = 0.5  # as is the object of poses nearer than this
_SAME_TURN = 0.2  # [rad] are the same
_CLEARLY_WORSE = 0.5  # poses that score less by this are none


class ModelTargetDetector:
    """Finds a CAD model; see `target.TargetDetector`.

    Args:
        config: the model, and when a sighting of it is believed.
        shape: the model's surface, where it does not come from ``config.file``.

    Raises:
        ConfigError: neither a file nor a shape is given.
        InvalidInputError: the file cannot be read.
    """

    def __init__(self, config: ModelTargetConfig, shape: ModelShape | None = None) -> None:
        if shape is None and not config.file:
            raise ConfigError("file", config.file, "the path of a mesh")
        self.config = config
        self.shape = shape or load_model(config.file, config.scale)
        diameter = self.shape.diameter
        self._search = ModelSearch(self.shape, config.tolerance * diameter)
        dense = self.shape.thinned(_DENSE * diameter)
        self._fitter = ModelFitter(dense, config.surface_sigma)
        self._comparison = PoseComparison(
            self.shape.thinned(_FINE * diameter),
            dense,
            _FINE * diameter,
            config.tolerance * diameter,
        )

    def detect(self, view: RangeView) -> TargetSighting | TargetRefusal:
        """Find the model in the view's dense range map, or say why not."""
        scene = ModelScene.of_cloud(view.cloud(), _FINE * self.shape.diameter)
        if len(scene.points) < 100:
            return _refuse("not in view", f"{len(scene.points)} points with a usable range")
        found = self._search.find(scene)
        believed = [one for one in found if self._believed(one)]
        if not believed:
            text = found[0].agreement.text() if found else "no votes"
            return _refuse("not in view", f"best pose: {text}")
        shaped = [one for one in believed if self._is_shaped(one)]
        if not shaped:
            return _refuse("ambiguous", "most of what is seen is one plane")
        others = self._search.others(scene, shaped[0].transform)
        shaped += [one for one in others if self._believed(one) and self._is_shaped(one)]
        best = max(shaped, key=lambda one: one.agreement.score)
        rival = self._rival(best, [*found, *others])
        if rival is not None:
            apart, turn = self._search.difference(best.transform, rival.transform)
            text = f"a pose {apart:.2f} m and {np.degrees(turn):.0f} deg away fits as well"
            return _refuse("ambiguous", text)
        return self._nearly_alike(scene, best, [*found, *others]) or self._sighting(scene, best)

    def _believed(self, one: Hypothesis) -> bool:
        agreement = one.agreement
        enough = agreement.score >= self.config.min_score
        return enough and agreement.seen_through <= self.config.max_seen_through

    def _is_shaped(self, one: Hypothesis) -> bool:
        return self._search.flat_share(one.transform) <= self.config.max_flat

    def _rival(self, best: Hypothesis, others: list[Hypothesis]) -> Hypothesis | None:
        """Another pose that fits about as well, or one of a single plane that fits better."""
        limit = best.agreement.score - self.config.distinction
        for other in others:
            apart, turn = self._search.difference(best.transform, other.transform)
            elsewhere = apart > _SAME_PLACE * self.shape.diameter or turn > _SAME_TURN
            if not elsewhere or other.agreement.score <= limit:
                continue
            same_object = apart < _SAME_OBJECT * self.shape.diameter
            better = other.agreement.score > best.agreement.score
            if same_object or better or self._is_shaped(other):
                return other
        return None

    def _nearly_alike(
        self, scene: ModelScene, best: Hypothesis, others: list[Hypothesis]
    ) -> TargetRefusal | None:
        """Refuse a pose that too little tells from another one of the same object."""
        for other in others:
            apart, turn = self._search.difference(best.transform, other.transform)
            if turn <= _SAME_TURN or apart > _SAME_OBJECT * self.shape.diameter:
                continue
            if other.agreement.score < best.agreement.score - _CLEARLY_WORSE:
                continue
            found = self._comparison.evidence(scene.cloud, best.transform, other.transform)
            few = found.places < self.config.min_evidence
            if few or found.against_share > self.config.max_against:
                text = (
                    f"{found.places} points tell it from a pose {np.degrees(turn):.0f} deg away, "
                    f"{found.against} of them speak against it"
                )
                return _refuse("ambiguous", text)
        return None

    def _sighting(self, scene: ModelScene, best: Hypothesis) -> TargetSighting | TargetRefusal:
        config, reach = self.config, self.config.tolerance * self.shape.diameter
        depth = transform_points(best.transform, self.shape.center)[2]
        near = np.abs(scene.cloud.points[:, 2] - depth) < 0.5 * self.shape.diameter
        sigma = float(np.sqrt(np.median(scene.cloud.covariances[near, 2, 2])))
        fit = self._fitter.fit(scene.cloud, best.transform, max(reach, 3.0 * sigma))
        if fit is None:
            return _refuse("too uncertain", "the visible surface leaves a direction open")
        moved, turned = self._search.difference(best.transform, fit.transform)
        if moved > _SAME_PLACE * self.shape.diameter or turned > _SAME_TURN:
            return _refuse("too uncertain", f"the refinement went {moved:.3f} m astray")
        position, rotation = _largest_sigmas(fit.covariance, fit.transform, self.shape.center)
        if position > config.max_position_sigma or rotation > config.max_rotation_sigma:
            return _refuse("too uncertain", f"sigma {position:.3f} m and {rotation:.3f} rad")
        refined = Hypothesis(fit.transform, self._search.check(fit.transform, scene))
        if not self._believed(refined):
            return _refuse("inconsistent", f"after refinement: {refined.agreement.text()}")
        return TargetSighting(fit.transform, fit.covariance, refined.agreement.score, _NAME)


def _largest_sigmas(
    covariance: FloatArray, pose: FloatArray, center: FloatArray
) -> tuple[float, float]:
    """Largest sigma of the position of the model's middle [m] and of the rotation [rad]."""
    sighting = TargetSighting(pose, covariance, 0.0, _NAME)
    shift = np.eye(4)
    shift[:3, 3] = center
    moved = sighting.of_frame(shift).covariance
    position = float(np.sqrt(np.linalg.eigvalsh(moved[:3, :3])[-1]))
    return position, float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))


def _refuse(reason: RefusalReason, detail: str) -> TargetRefusal:
    return TargetRefusal(reason, detail, _NAME)
