# Warp's kernel language is no Python that a type checker can follow: `wp.array[wp.vec3]` in a signature, structs made
# of annotations, functions that become kernels. For the host code around it, Warp is untyped.
from typing import Any

def __getattr__(name: str) -> Any: ...
