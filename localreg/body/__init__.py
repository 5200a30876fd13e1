"""The body: skeleton, subject, MuJoCo model and JAX kinematics."""
