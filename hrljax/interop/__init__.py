"""The environments for other libraries: `hrljax.interop.gymnasium` and `hrljax.interop.gymnax`."""
