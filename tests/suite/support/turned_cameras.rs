//! Cameras that look about.

use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};

/// A camera at `center` whose axes in the world are those of `rotation`.
pub fn camera(center: DVec3, rotation: DQuat) -> Camera {
    let rotation = DMat3::from_quat(rotation).transpose();
    Camera {
        rotation,
        center,
        fx: 80.0,
        fy: 81.0,
        cx: 40.0,
        cy: 30.0,
        width: 80,
        height: 60,
    }
}

/// A camera at `eye` that looks at `at`, z up.
pub fn looking(eye: DVec3, at: DVec3) -> Camera {
    let forward = (at - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let axes = DMat3::from_cols(right, forward.cross(right), forward);
    camera(eye, DQuat::from_mat3(&axes))
}

/// Cameras here and there, none where another is.
pub fn some(count: usize) -> Vec<Camera> {
    let pose = |i: usize| {
        let t = i as f64;
        let center =
            DVec3::new(3.0 * (1.3 * t).sin(), 2.0 * (0.7 * t).cos(), 0.4 * t) + DVec3::splat(1e5);
        camera(
            center,
            DQuat::from_euler(glam::EulerRot::ZYX, 0.8 * t, 0.3 * (2.0 * t).sin(), 0.2 * t),
        )
    };
    (0..count).map(pose).collect()
}

/// Asserts that the axes of the camera are orthonormal and right-handed.
pub fn assert_rotation(camera: &Camera) {
    let off = camera.rotation.transpose() * camera.rotation - DMat3::IDENTITY;
    assert!(
        off.to_cols_array().iter().all(|v| v.abs() < 1e-12),
        "{camera:?}"
    );
    assert!(
        camera.rotation.determinant() > 0.0 && camera.center.is_finite(),
        "{camera:?}"
    );
}
