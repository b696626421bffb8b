"""Many runs: one function over many cases, on any pool, and what `pinconsist sweep` varies, keeps and writes."""
