"""Files of images: camera RAW, photographs, OpenEXR."""
