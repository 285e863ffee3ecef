"""Studies of a scene: how errors fall with the discretisation, and what each digit costs."""
