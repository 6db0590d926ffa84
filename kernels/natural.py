"""Indices that the compiler knows to be none below 0."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def natural(index: wp.int32) -> wp.int32:
    """The index, which is 0 or more.

    Warp lets indices below 0 count from an array's end. Where it cannot tell whether one is, it finds out with every
    access, in more instructions than the access itself takes: a sum over neighbours takes up to 1.6 times as long.
    """
    return index & 0x7FFFFFFF
