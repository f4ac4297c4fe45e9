"""Sources of uncertainty: one file each adds states and channels to the loop, and states what it assumes."""
