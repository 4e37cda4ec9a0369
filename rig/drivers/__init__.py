"""Device drivers: SI units above, bytes below. They are synchronous and belong to one thread; `clock` alone waits."""
