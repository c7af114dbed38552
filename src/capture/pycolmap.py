# One step of COLMAP: what the command line of `colmap` does in poses.rs.
import sys

import pycolmap

step, database, images, sparse, *masks = sys.argv[1:]
if step == "features":
    options = pycolmap.ImageReaderOptions()
    options.camera_model = "OPENCV"
    if masks:
        options.mask_path = masks[0]
    mode = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, images, camera_mode=mode, reader_options=options)
elif step == "matches":
    pycolmap.match_exhaustive(database)
else:
    pycolmap.incremental_mapping(database, images, sparse)
