"""Engine `planar`: MuJoCo's contact problem for disks on a plane with a kinematic hand, in JAX."""
