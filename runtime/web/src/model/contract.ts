/** Of `decomo_runtime/contract.py`, written by `contract.py`: do not edit. */

export const FORMAT_VERSION = 1 as const;
export const INPUTS = ["queries", "frames"] as const;
export const TRACKING = ["tracks", "occlusion"] as const;
export const APPEARANCE = ["rgb", "rgb_static", "rgb_dynamic", "static_confidence", "depth", "static_opacity"] as const;
export const OUTPUTS = ["tracks", "occlusion", "rgb", "rgb_static", "rgb_dynamic", "static_confidence", "depth", "static_opacity"] as const;
export const REQUIRED_OUTPUTS = ["tracks", "occlusion", "rgb", "rgb_static", "rgb_dynamic", "static_confidence", "depth"] as const;
export const LAYERS = ["fused", "static", "dynamic", "mask", "depth"] as const;
export const FARTHEST = 2.0 as const;
export const HOLE = 0.1 as const;
