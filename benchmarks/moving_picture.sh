#!/usr/bin/env bash
# The README's moving picture: points of an object followed through the clip, as `decomo-track --overlay` draws them.
#
#   benchmarks/moving_picture.sh MODEL CLIP MASK@T OUT.webp
set -euo pipefail
[ $# = 4 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0" >&2; exit 2; }

work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
decomo-track "$1" --clip "$2" --mask "$3" --spacing 14 --on dynamic --trails camera \
  --out "$work/tracks.npz" --overlay "$work/tracks.mp4"
ffmpeg -y -loglevel error -i "$work/tracks.mp4" -vf "setpts=1.6*PTS,fps=15,scale=640:-2:flags=lanczos" \
  -c:v libwebp_anim -loop 0 -quality 60 -compression_level 6 "$4"
