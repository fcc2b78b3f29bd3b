//! USD's camera → image plane: from pixels to rays and back.
//!
//! As `GfCamera` and UsdRender have it: apertures and focal length share a unit, tenths of a stage unit, which cancels
//! for a perspective camera; the filmback is conformed to the image by `aspectRatioConformPolicy` about its own
//! (offset) center.

use crate::scene::Camera;
use crate::scene::camera::Projection;
use glam::{DMat4, DVec2, DVec3};

/// Apertures and focal lengths are in tenths of a stage unit.
const APERTURE_UNIT: f64 = 0.1;

/// USD's default focal length, for cameras without a usable one.
const DEFAULT_FOCAL_LENGTH: f64 = 50.0;

/// USD's default apertures, for cameras without usable ones.
const DEFAULT_APERTURE: DVec2 = DVec2::new(20.955, 15.2908);

/// `aspectRatioConformPolicy` of UsdRender: what to do when filmback and image have different shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ConformPolicy {
    /// Enlarge the aperture on one axis: all that the camera sees is in the image.
    #[default]
    ExpandAperture,
    /// Reduce it on one axis: all of the image is seen by the camera.
    CropAperture,
    /// Keep the height.
    AdjustApertureWidth,
    /// Keep the width.
    AdjustApertureHeight,
    /// Keep the aperture; pixels become oblong.
    AdjustPixelAspectRatio,
}

impl ConformPolicy {
    /// From the USD token; `None` for any other word.
    pub fn from_token(token: &str) -> Option<Self> {
        match token {
            "expandAperture" => Some(Self::ExpandAperture),
            "cropAperture" => Some(Self::CropAperture),
            "adjustApertureWidth" => Some(Self::AdjustApertureWidth),
            "adjustApertureHeight" => Some(Self::AdjustApertureHeight),
            "adjustPixelAspectRatio" => Some(Self::AdjustPixelAspectRatio),
            _ => None,
        }
    }
}

/// The pixels of an image and how a camera's filmback is fitted to them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Width over height of one pixel.
    pub pixel_aspect_ratio: f64,
    /// How the filmback is fitted.
    pub conform_policy: ConformPolicy,
}

impl Frame {
    /// Square pixels, USD's default policy.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            pixel_aspect_ratio: 1.0,
            conform_policy: ConformPolicy::default(),
        }
    }
}

/// A camera ray in camera space (looking along −Z), in `f64`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CameraRay {
    /// On the near clipping plane.
    pub(super) origin: DVec3,
    /// Unit.
    pub(super) direction: DVec3,
    /// From the near to the far clipping plane along `direction`.
    pub(super) length: f64,
}

/// A camera fitted to an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    projection: Projection,
    world_to_camera: DMat4,
    /// Corner of the window at the image's lower left, at distance 1 (perspective) or any (orthographic).
    low: DVec2,
    /// Corner at the image's upper right.
    high: DVec2,
    near: f64,
    far: f64,
    frame: Frame,
    pixel_aspect_ratio: f64,
}

impl Lens {
    /// Fit `camera` to `frame`. Apertures and focal lengths that are not positive are taken as USD's defaults; near
    /// planes behind the camera as 0, far planes before the near one as infinitely far.
    pub fn new(camera: &Camera, frame: Frame) -> Self {
        let positive = |value: f64, default: f64| {
            if value > 0.0 && value.is_finite() {
                value
            } else {
                default
            }
        };
        let aperture = DVec2::new(
            positive(camera.horizontal_aperture, DEFAULT_APERTURE.x),
            positive(camera.vertical_aperture, DEFAULT_APERTURE.y),
        );
        let pixels = f64::from(frame.width.max(1)) / f64::from(frame.height.max(1));
        let pixel_aspect = positive(frame.pixel_aspect_ratio, 1.0);
        let (aperture, pixel_aspect_ratio) =
            conform(aperture, pixels, pixel_aspect, frame.conform_policy);
        let offset = DVec2::new(
            camera.horizontal_aperture_offset,
            camera.vertical_aperture_offset,
        );
        let scale = match camera.projection {
            Projection::Perspective => 1.0 / positive(camera.focal_length, DEFAULT_FOCAL_LENGTH),
            Projection::Orthographic => APERTURE_UNIT,
        };
        let near = camera.clipping_range.0.max(0.0);
        Self {
            projection: camera.projection,
            world_to_camera: DMat4::from(camera.world_from_camera.inverse()),
            low: (offset - 0.5 * aperture) * scale,
            high: (offset + 0.5 * aperture) * scale,
            near,
            far: if camera.clipping_range.1 > near {
                camera.clipping_range.1
            } else {
                f64::INFINITY
            },
            frame,
            pixel_aspect_ratio,
        }
    }

    /// Width over height of one pixel after conforming.
    pub fn pixel_aspect_ratio(&self) -> f64 {
        self.pixel_aspect_ratio
    }

    /// World (absolute) to camera space: right-handed, looking along −Z, as in USD.
    pub fn world_to_camera(&self) -> DMat4 {
        self.world_to_camera
    }

    /// World (absolute) to the image: (0, 0) at the upper left and (1, 1) at the lower right of the display window
    /// after dividing by w, as OpenEXR's standard attribute `worldToNDC`; z is the distance along the viewing axis
    /// (times w).
    pub fn world_to_ndc(&self) -> DMat4 {
        let size = self.high - self.low;
        let (x, y) = (1.0 / size.x, -1.0 / size.y);
        let (left, top) = (-self.low.x / size.x, self.high.y / size.y);
        let ndc_from_camera = match self.projection {
            // w = −z: the window at distance 1 is scaled by the distance.
            Projection::Perspective => DMat4::from_cols_array(&[
                x, 0.0, 0.0, 0.0, 0.0, y, 0.0, 0.0, -left, -top, -1.0, -1.0, 0.0, 0.0, 0.0, 0.0,
            ]),
            Projection::Orthographic => DMat4::from_cols_array(&[
                x, 0.0, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, left, top, 0.0, 1.0,
            ]),
        };
        ndc_from_camera * self.world_to_camera
    }

    /// Size of a pixel at distance `depth` along the viewing axis, stage units: the edge of a square of its area.
    pub fn pixel_size(&self, depth: f64) -> f64 {
        let window = self.high - self.low;
        let pixels = f64::from(self.frame.width.max(1)) * f64::from(self.frame.height.max(1));
        let at_one = (window.x * window.y / pixels).sqrt();
        match self.projection {
            Projection::Perspective => at_one * depth,
            Projection::Orthographic => at_one,
        }
    }

    /// Distance of the near clipping plane, stage units.
    pub fn near_distance(&self) -> f64 {
        self.near
    }

    /// Ray through image point `(x, y)` in pixels from the upper left corner (pixel centers at halves).
    pub(super) fn ray(&self, x: f64, y: f64) -> CameraRay {
        let across = x / f64::from(self.frame.width.max(1));
        let up = 1.0 - y / f64::from(self.frame.height.max(1));
        let window = self.low + (self.high - self.low) * DVec2::new(across, up);
        match self.projection {
            Projection::Perspective => {
                let at_one = window.extend(-1.0);
                let stretch = at_one.length();
                CameraRay {
                    origin: at_one * self.near,
                    direction: at_one / stretch,
                    length: (self.far - self.near) * stretch,
                }
            }
            Projection::Orthographic => CameraRay {
                origin: window.extend(-self.near),
                direction: DVec3::NEG_Z,
                length: self.far - self.near,
            },
        }
    }
}

/// Aperture and pixel aspect ratio for an image `pixels` wide as high, after `policy`.
fn conform(aperture: DVec2, pixels: f64, pixel_aspect: f64, policy: ConformPolicy) -> (DVec2, f64) {
    let image = pixels * pixel_aspect;
    let camera = aperture.x / aperture.y;
    let keep_height = match policy {
        ConformPolicy::ExpandAperture => image > camera,
        ConformPolicy::CropAperture => image < camera,
        ConformPolicy::AdjustApertureWidth => true,
        ConformPolicy::AdjustApertureHeight => false,
        ConformPolicy::AdjustPixelAspectRatio => return (aperture, camera / pixels),
    };
    let conformed = if keep_height {
        DVec2::new(aperture.y * image, aperture.y)
    } else {
        DVec2::new(aperture.x, aperture.x / image)
    };
    (conformed, pixel_aspect)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use glam::{DAffine3, DMat3};

    /// The camera whose numbers below come from usd-core 26.11 (Gf.Camera, Gf.Frustum).
    pub(in crate::receivers) fn camera(projection: Projection) -> Camera {
        Camera {
            path: "/camera".into(),
            world_from_camera: DAffine3::from_mat3_translation(
                DMat3::from_cols_array_2d(&[
                    [
                        0.782_755_554_324_765_3,
                        0.548_798_866_963_804_2,
                        -0.293_451_096_084_124_56,
                    ],
                    [
                        -0.481_954_422_140_655_1,
                        0.832_888_887_942_127_2,
                        0.272_058_882_085_466_9,
                    ],
                    [
                        0.393_717_763_318_848_2,
                        -0.071_525_547_616_019_51,
                        0.916_444_443_971_063_6,
                    ],
                ]),
                DVec3::new(10.0, -4.0, 7.0),
            ),
            projection,
            horizontal_aperture: 24.0,
            vertical_aperture: 18.0,
            horizontal_aperture_offset: 3.0,
            vertical_aperture_offset: -2.0,
            focal_length: 35.0,
            clipping_range: (0.5, 1000.0),
            exposure: 0.0,
        }
    }

    /// World point and its normalized device coordinates by `frustum.ComputeViewMatrix() * ComputeProjectionMatrix()`
    /// (−1…1, y up), and its distance along the viewing axis.
    const PERSPECTIVE: [([f64; 3], [f64; 2], f64); 3] = [
        (
            [0.0, 0.0, 0.0],
            [-1.231_015_243_949_233_5, 2.505_713_602_732_548_4],
            10.638_390_931_450_004,
        ),
        (
            [9.0, -6.0, 2.0],
            [-0.499_306_084_644_743_5, -1.824_957_329_079_653_2],
            4.832_888_887_942_127_5,
        ),
        (
            [12.0, -3.0, -20.0],
            [0.968_407_756_734_292_8, -0.987_849_184_264_317_7],
            24.028_090_008_197_04,
        ),
    ];
    const ORTHOGRAPHIC: [([f64; 3], [f64; 2], f64); 3] = [
        (
            [0.0, 0.0, 0.0],
            [-3.231_835_335_669_64, 7.162_986_220_640_878],
            10.638_390_931_450_004,
        ),
        (
            [9.0, -6.0, 2.0],
            [-0.594_248_173_193_126_4, -2.604_575_293_523_259_6],
            4.832_888_887_942_127_5,
        ),
        (
            [12.0, -3.0, -20.0],
            [8.114_574_641_570_579, -8.085_121_969_607_538],
            24.028_090_008_197_04,
        ),
    ];

    #[test]
    fn points_project_to_the_coordinates_of_usd_core() {
        for (projection, points) in [
            (Projection::Perspective, PERSPECTIVE),
            (Projection::Orthographic, ORTHOGRAPHIC),
        ] {
            // 4:3 as the aperture: nothing to conform.
            let lens = Lens::new(&camera(projection), Frame::new(640, 480));
            for (point, [x, y], depth) in points {
                let clip = lens.world_to_ndc() * DVec3::from(point).extend(1.0);
                let ndc = clip.truncate() / clip.w;
                assert!((ndc.x - (0.5 + 0.5 * x)).abs() < 1e-9, "{ndc} {x}");
                assert!((ndc.y - (0.5 - 0.5 * y)).abs() < 1e-9, "{ndc} {y}");
                assert!((clip.z - depth).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn rays_through_a_projected_point_pass_through_the_point() {
        for projection in [Projection::Perspective, Projection::Orthographic] {
            let camera = camera(projection);
            let lens = Lens::new(
                &camera,
                Frame {
                    pixel_aspect_ratio: 2.0,
                    ..Frame::new(300, 100)
                },
            );
            let point = DVec3::new(9.0, -6.0, 2.0);
            let clip = lens.world_to_ndc() * point.extend(1.0);
            let ray = lens.ray(clip.x / clip.w * 300.0, clip.y / clip.w * 100.0);
            let origin = camera.world_from_camera.transform_point3(ray.origin);
            let direction = camera.world_from_camera.transform_vector3(ray.direction);
            let along = (point - origin).dot(direction);
            assert!((origin + direction * along).distance(point) < 1e-12);
            assert!(
                (ray.origin.z + 0.5).abs() < 1e-12,
                "starts on the near plane"
            );
            assert!(
                ((ray.origin + ray.direction * ray.length).z + 1000.0).abs() < 1e-9,
                "ends on the far plane"
            );
        }
    }

    #[test]
    fn policies_conform_the_aperture_as_usd_render_defines_them() {
        use ConformPolicy::{
            AdjustApertureHeight, AdjustApertureWidth, AdjustPixelAspectRatio, CropAperture,
            ExpandAperture,
        };
        let aperture = DVec2::new(24.0, 18.0);
        for (pixels, policy, expected, pixel_aspect) in [
            (2.0, ExpandAperture, [36.0, 18.0], 1.0),
            (1.0, ExpandAperture, [24.0, 24.0], 1.0),
            (2.0, CropAperture, [24.0, 12.0], 1.0),
            (1.0, CropAperture, [18.0, 18.0], 1.0),
            (1.0, AdjustApertureWidth, [18.0, 18.0], 1.0),
            (2.0, AdjustApertureHeight, [24.0, 12.0], 1.0),
            (2.0, AdjustPixelAspectRatio, [24.0, 18.0], 2.0 / 3.0),
        ] {
            let (conformed, aspect) = conform(aperture, pixels, 1.0, policy);
            assert!(
                conformed.distance(DVec2::from(expected)) < 1e-12,
                "{policy:?}"
            );
            assert!((aspect - pixel_aspect).abs() < 1e-12);
        }
        assert_eq!(
            ConformPolicy::from_token("cropAperture"),
            Some(CropAperture)
        );
        assert_eq!(ConformPolicy::from_token("crop"), None);
    }

    #[test]
    fn unusable_cameras_fall_back_to_the_defaults_of_usd() {
        let broken = Camera {
            horizontal_aperture: 0.0,
            vertical_aperture: f64::NAN,
            focal_length: -1.0,
            ..camera(Projection::Perspective)
        };
        let default = Camera {
            horizontal_aperture: 20.955,
            vertical_aperture: 15.2908,
            focal_length: 50.0,
            ..camera(Projection::Perspective)
        };
        let frame = Frame::new(64, 64);
        assert_eq!(Lens::new(&broken, frame), Lens::new(&default, frame));
    }
}
