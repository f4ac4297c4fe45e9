"""Sources of uncertainty: one file each adds states and channels to the loop of a craft."""
