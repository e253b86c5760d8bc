"""`keycld info`."""

import os


def info() -> None:
    """Print versions of packages, JAX's devices, where compiled programs are kept, and MuJoCo's renderer."""
    from keycld._compile_cache import use_compile_cache
    from keycld._errors import KeycldError
    from keycld.systems import is_software, renderer_name
    from keycld.training import environment

    facts = environment()
    print(f"python      {facts['python']}  on {facts['platform']}")
    print(f"processor   {facts['processor']}, {facts['cores']} cores")
    for package, version in facts["packages"].items():
        print(f"{package:11s} {version or 'not installed'}")
    print(f"devices     {', '.join(facts['devices'])}")
    print("precision   float32; matrix products in mechanics at 'highest', so no TF32")
    cache = use_compile_cache()
    kept = f"{cache.folder}, {cache.bytes / 1e6:.0f} MB" if cache.folder else f"none: {cache.note}"
    print(f"programs    {kept}")
    try:
        name = renderer_name()
    except KeycldError as error:
        print(f"renderer    none: {error}")
        return
    print(f"renderer    {name} (MUJOCO_GL={os.environ.get('MUJOCO_GL', 'egl')})")
    if is_software(name):
        print("            a software renderer: correct pictures, about 100 frames/s a core; a GPU's is faster")
