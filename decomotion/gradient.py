"""The gradient of a batch: prediction -> losses -> gradients; on a CUDA device recorded once and replayed.

A step of the `cpu` preset is some thousand small operations: on a GPU their launches, not their arithmetic, are what
takes time. A CUDA graph records them once and launches them as one. What is recorded reads its numbers from fixed
places, has fixed shapes and never waits for the host.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from decomotion.data.batch import Batch
from decomotion.losses import LOSSES
from decomotion.model.fusion import DecoMotion


class Terms(NamedTuple):
    """What one part of a batch gave."""

    losses: Float[Tensor, " loss"]
    """Unweighted."""
    error: Float[Tensor, "pair point"]
    """Distance of the fused position from the target, in units."""


class Accumulator:
    """Adds gradients of weighted losses to those of a model's parameters.

    Args:
        model: the model, on its device.
        smooth_share: of each pair's points, at which smoothness is evaluated.
        recorded: whether CUDA graphs are used; None: where the model is on a CUDA device.
    """

    def __init__(self, model: DecoMotion, smooth_share: float, recorded: bool | None = None) -> None:
        self.model, self.smooth_share = model, smooth_share
        self.device = next(model.parameters()).device
        self.recorded = self.device.type == "cuda" if recorded is None else recorded
        self._recordings: dict[tuple[tuple[str, ...], torch.Size], _Recording] = {}

    def add(self, batch: Batch, offset: Float[Tensor, "pair point sample"], weights: dict[str, float]) -> Terms:
        """Adds the gradient of the sum of weighted losses, and gives them in the order of `weights`.

        Args:
            batch: some pairs.
            offset: where in its bin each sample of their rays lies (`decomotion.rays.sample_depths`).
            weights: of the losses by name.
        """
        given = (batch.to(self.device), offset.to(self.device), torch.tensor(list(weights.values())).to(self.device))
        return self._replay(tuple(weights), *given) if self.recorded else self._add(tuple(weights), *given)

    def _add(self, names: tuple[str, ...], batch: Batch, offset: Tensor, weights: Float[Tensor, " loss"]) -> Terms:
        smooth_points = round(self.smooth_share * batch.xy.shape[1])
        prediction = self.model.predict(batch.xy, batch.frame, batch.target_frame, offset, smooth_points)
        losses = torch.stack([LOSSES[name](prediction, batch) for name in names])
        (weights @ losses).backward()
        return Terms(losses.detach(), (prediction.fused_xy.detach() - batch.target_xy).norm(dim=-1))

    def _replay(self, names: tuple[str, ...], batch: Batch, offset: Tensor, weights: Float[Tensor, " loss"]) -> Terms:
        kind = (names, offset.shape)
        if kind not in self._recordings:
            self._recordings = {each: it for each, it in self._recordings.items() if each[0] == kind[0]}  # of the past
            self._recordings[kind] = _Recording(self, names, batch, offset, weights)
        return self._recordings[kind].replay(batch, offset, weights)


class _Recording:
    """One computation of an accumulator as a CUDA graph."""

    WARM_UP = 3
    """Runs before the recording, in which libraries choose their kernels and take their memory."""

    def __init__(
        self, of: Accumulator, names: tuple[str, ...], batch: Batch, offset: Tensor, weights: Float[Tensor, " loss"]
    ) -> None:
        self.given = tuple(value.clone() for value in (*vars(batch).values(), offset, weights))
        *parts, offset, weights = self.given
        batch = Batch(*parts)
        gradients = [_gradient(parameter) for parameter in of.model.parameters()]
        before = [gradient.clone() for gradient in gradients]
        beside = torch.cuda.Stream(of.device)
        beside.wait_stream(torch.cuda.current_stream(of.device))
        with torch.cuda.stream(beside):
            for _ in range(self.WARM_UP):
                of._add(names, batch, offset, weights)
        torch.cuda.current_stream(of.device).wait_stream(beside)
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph):
            self.terms = of._add(names, batch, offset, weights)
        for gradient, former in zip(gradients, before, strict=True):
            gradient.copy_(former)

    def replay(self, batch: Batch, offset: Tensor, weights: Float[Tensor, " loss"]) -> Terms:
        """As the accumulator's own computation."""
        for place, value in zip(self.given, (*vars(batch).values(), offset, weights), strict=True):
            place.copy_(value, non_blocking=True)
        self.graph.replay()
        return Terms(self.terms.losses.clone(), self.terms.error.clone())


def _gradient(parameter: nn.Parameter) -> Tensor:
    """Where its gradient is added up: there from now on."""
    if parameter.grad is None:
        parameter.grad = torch.zeros_like(parameter)
    return parameter.grad
