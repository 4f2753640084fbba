"""Live segmentation of moving objects seen through atmospheric turbulence."""
