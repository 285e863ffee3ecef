"""Hard cases: what makes each hard, what a plain method gives there, and what ours must hold."""
