"""From a clip to the correspondences that supervise the fit."""
