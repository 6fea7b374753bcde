"""What people draw on a few frames, carried to all others: masks, polygons, boxes and keypoints."""
