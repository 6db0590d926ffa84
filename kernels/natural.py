"""Telling the compiler that an index is not below 0."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def natural(index: wp.int32) -> wp.int32:
    """The index, which the caller knows to be 0 or more; it is not checked, and -1 would be far past the array's end.

    Warp lets indices below 0 count from an array's end, and asks at every access whether one is, in more instructions
    than the access itself takes, unless the compiler can tell. With this it can: a sum over neighbours, whose indices
    are read from memory, takes 0.6 of the time.
    """
    return index & 0x7FFFFFFF
