"""Parts of the compiled step, one meaning each; all are inlined into the kernel."""
