"""Optical flow between two frames: a small interface and the estimators behind it."""

from __future__ import annotations

from decomotion.data.flow.config import DisFlowConfig, FlowConfig, FolderFlowConfig, RaftFlowConfig
from decomotion.data.flow.interface import Flow, FlowEstimator, Frame

__all__ = ["Flow", "FlowEstimator", "Frame", "build_flow"]


def build_flow(config: FlowConfig, device: str = "cpu") -> FlowEstimator:
    """The estimator that `config` describes; those with weights load them here and run on `device`.

    Raises `SupervisionError` where weights or the folder of fields are missing or do not fit, or a library is not
    installed.
    """
    if isinstance(config, RaftFlowConfig):
        from decomotion.data.flow.raft import RaftFlow

        return RaftFlow(config, device)
    if isinstance(config, FolderFlowConfig):
        from decomotion.data.flow.folder import FolderFlow

        return FolderFlow(config)
    from decomotion.data.flow.dis import DisFlow

    assert isinstance(config, DisFlowConfig)
    return DisFlow(config)
