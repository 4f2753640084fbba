"""Videos, folders of images and masks: what becomes a bag."""
