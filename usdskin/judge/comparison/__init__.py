"""How far a picture is from the true one."""
