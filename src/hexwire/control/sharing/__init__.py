"""One arm for several programs: the lease, orders, and motions that begin together."""
