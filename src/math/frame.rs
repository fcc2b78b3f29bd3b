//! Orthonormal frames about a normal.

use glam::Vec3;

/// A right-handed orthonormal frame whose third axis is a given normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// First tangent, unit.
    pub tangent: Vec3,
    /// Second tangent, unit: `normal × tangent`.
    pub bitangent: Vec3,
    /// The normal it was made for, unit.
    pub normal: Vec3,
}

impl Frame {
    /// Frame about the unit vector `normal`; continuous except at `normal.z = 0` crossing its sign.
    /// Duff et al., *Building an Orthonormal Basis, Revisited* (2017).
    pub fn about(normal: Vec3) -> Self {
        let sign = 1.0_f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(
                1.0 + sign * normal.x * normal.x * a,
                sign * b,
                -sign * normal.x,
            ),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    /// World direction of `local`, given in (tangent, bitangent, normal) coordinates.
    pub fn to_world(&self, local: Vec3) -> Vec3 {
        self.tangent * local.x + self.bitangent * local.y + self.normal * local.z
    }

    /// (tangent, bitangent, normal) coordinates of the world direction `world`.
    pub fn to_local(&self, world: Vec3) -> Vec3 {
        Vec3::new(
            world.dot(self.tangent),
            world.dot(self.bitangent),
            world.dot(self.normal),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_right_handed_in_all_octants() {
        for n in [
            Vec3::X,
            -Vec3::X,
            Vec3::Z,
            -Vec3::Z,
            Vec3::new(1.0, -2.0, -3.0).normalize(),
        ] {
            let f = Frame::about(n);
            assert!(f.tangent.cross(f.bitangent).dot(n) > 0.999_99);
            assert!(f.tangent.dot(n).abs() < 1e-6);
            let local = Vec3::new(0.2, -0.3, 0.5);
            assert!(f.to_local(f.to_world(local)).abs_diff_eq(local, 1e-6));
        }
    }
}
