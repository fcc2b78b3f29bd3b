//! Pixar's point clouds (`.ptc`) ↔ points, as public readers of the format document it.
//!
//! Little endian: `pptc`, version, count (double), bounds, [from version 1 four numbers; from 2 the largest radius and 32 more],
//! world-to-eye and eye-to-screen matrices, three numbers of the image, count of channels and of their floats, a line
//! `type name` a channel, [from 1 two numbers], then the points: position, normal in two 16-bit numbers (angle about z,
//! height), radius, channels.
//!
//! | channel | column |
//! |---|---|
//! | `_radiosity`, `_area` … | the name without the underscore that `bake3d` puts before it |
//! | `color`, `normal` | colors, directions |
//! | `point`, `vector` | vectors |
//! | `matrix` | left out, with a warning |
//!
//! Written is version 0, which every reader takes. Normals lose digits: they are up to 0.05° off near ±z, a tenth of that elsewhere.

use super::{Error, malformed, read_file};
use crate::diagnostics::Diagnostics;
use crate::surfels::points::{Column, ColumnValues, PointSet, VectorKind};
use crate::writers::write_streamed;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};
use std::path::Path;

const MAGIC: &[u8; 4] = b"pptc";

/// Newest version that readers know.
const NEWEST: i32 = 2;

/// Bytes of a point before its channels: position, normal, radius.
const FIXED: usize = 20;

/// Codes of a normal that is not there.
const NO_NORMAL: [u16; 2] = [u16::MAX, u16::MAX];

/// Camera that files carry when there was none: PRMan's bake files have one, readers pass over it.
const IMAGE: [f32; 3] = [640.0, 480.0, 300.0];

/// Points made by one thread at a time.
const CHUNK: usize = 8192;

/// Chunks in memory at a time.
const CHUNKS: usize = 32;

/// A channel as declared.
struct Channel {
    type_name: String,
    name: String,
    /// Where it begins in a point's bytes.
    start: usize,
}

impl Channel {
    fn width(type_name: &str) -> Option<usize> {
        Some(match type_name {
            "float" => 1,
            "color" | "point" | "vector" | "normal" => 3,
            "matrix" => 16,
            _ => return None,
        })
    }
}

/// A file from its start.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(count);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or_else(|| "it ends within its header".to_owned())?;
        self.at += count;
        Ok(taken)
    }

    fn int(&mut self) -> Result<i32, String> {
        self.take(4)
            .map(|bytes| i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    fn double(&mut self) -> Result<f64, String> {
        let bytes = self.take(8)?;
        let mut all = [0; 8];
        all.copy_from_slice(bytes);
        Ok(f64::from_le_bytes(all))
    }

    fn line(&mut self) -> Result<&'a str, String> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|&byte| byte == b'\n');
        let length = length.ok_or("a channel's line does not end")?;
        self.at += length + 1;
        std::str::from_utf8(&rest[..length]).map_err(|_| "a channel's name is not text".to_owned())
    }
}

/// The points of the file at `path`. Values that are not finite count as 0, with a warning.
///
/// # Errors
/// Files that are none of these, are too new or shorter than they say; positions that are not finite.
pub fn read(path: &Path, diagnostics: &Diagnostics) -> Result<PointSet, Error> {
    let bytes = read_file(path)?;
    let place = path.to_string_lossy();
    let set = points(&bytes, &|message| {
        diagnostics.warn("lost", place.clone(), message);
    });
    let mut set = set.map_err(malformed(path))?;
    let bad = set.remove_non_finite();
    if bad > 0 {
        let message = format!("{bad} values are not finite and count as 0");
        diagnostics.warn("non-finite", place.clone(), message);
    }
    Ok(set)
}

fn points(bytes: &[u8], lost: &dyn Fn(String)) -> Result<PointSet, String> {
    let mut reader = Reader { bytes, at: 0 };
    if reader.take(4) != Ok(MAGIC) {
        return Err("it is no .ptc file: it does not begin with \"pptc\"".to_owned());
    }
    let version = reader.int()?;
    if !(0..=NEWEST).contains(&version) {
        return Err(format!(
            "its version is {version}, not one of 0 to {NEWEST}"
        ));
    }
    let count = reader.double()?;
    let extra = [0, 4 * 4, 4 * 4 + 33 * 4][usize::try_from(version).unwrap_or(0)];
    reader.take(6 * 4 + extra + 32 * 4 + 3 * 4)?;
    let (channel_count, declared) = (reader.int()?, reader.int()?);
    let (channels, floats) = channels(&mut reader, channel_count)?;
    if usize::try_from(declared) != Ok(floats) {
        return Err(format!(
            "its channels have {floats} floats a point, its header says {declared}"
        ));
    }
    if version >= 1 {
        reader.take(8)?;
    }
    let rest = &bytes[reader.at..];
    let stride = FIXED + 4 * floats;
    let there = rest.len() / stride;
    #[expect(
        clippy::cast_precision_loss,
        reason = "fewer points than bytes in memory"
    )]
    let fits = count >= 0.0 && count.fract() == 0.0 && count <= there as f64;
    if !fits {
        return Err(format!(
            "it says that it has {count} points, {there} are there"
        ));
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "whole and at most as many as are there"
    )]
    let rows = &rest[..count as usize * stride];
    decode(rows, stride, &channels, lost)
}

fn channels(reader: &mut Reader<'_>, count: i32) -> Result<(Vec<Channel>, usize), String> {
    let mut channels = Vec::new();
    let mut floats = 0;
    for _ in 0..count {
        let line = reader.line()?;
        let (type_name, name) = line
            .split_once(' ')
            .ok_or_else(|| format!("{line:?} declares no channel"))?;
        let width = Channel::width(type_name);
        let width =
            width.ok_or_else(|| format!("channel {name} is of the unknown type {type_name}"))?;
        channels.push(Channel {
            type_name: type_name.to_owned(),
            name: name.trim().to_owned(),
            start: FIXED + 4 * floats,
        });
        floats += width;
    }
    Ok((channels, floats))
}

fn float(row: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]])
}

fn vector(row: &[u8], at: usize) -> Vec3 {
    Vec3::new(float(row, at), float(row, at + 4), float(row, at + 8))
}

fn decode(
    rows: &[u8],
    stride: usize,
    channels: &[Channel],
    lost: &dyn Fn(String),
) -> Result<PointSet, String> {
    let rows = || rows.par_chunks_exact(stride);
    let position: Vec<Vec3> = rows().map(|row| vector(row, 0)).collect();
    if let Some(at) = position.par_iter().position_first(|p| !p.is_finite()) {
        return Err(format!("the position of point {at} is not finite"));
    }
    let code = |row: &[u8], at: usize| u16::from_le_bytes([row[at], row[at + 1]]);
    let normal = rows().map(|row| decode_normal([code(row, 12), code(row, 14)]));
    let mut set = PointSet {
        normal: Some(normal.collect()),
        radius: Some(rows().map(|row| float(row, 16).max(0.0)).collect()),
        position,
        ..PointSet::default()
    };
    for channel in channels {
        let start = channel.start;
        let vectors =
            |kind| ColumnValues::Vectors(kind, rows().map(|row| vector(row, start)).collect());
        let values = match channel.type_name.as_str() {
            "float" => ColumnValues::Floats(rows().map(|row| float(row, start)).collect()),
            "color" => vectors(VectorKind::Color),
            "normal" => vectors(VectorKind::Normal),
            "matrix" => {
                lost(format!("its matrices {} are left out", channel.name));
                continue;
            }
            _ => vectors(VectorKind::Vector),
        };
        let mut name = channel
            .name
            .strip_prefix('_')
            .unwrap_or(&channel.name)
            .to_owned();
        while name.is_empty() || set.column(&name).is_some() {
            name.push('_');
        }
        set.columns.push(Column { name, values });
    }
    Ok(set)
}

/// Write `points`, absolute, to `path`. Points without a radius get 0, whole numbers become floats.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write(points: &PointSet, path: &Path, diagnostics: &Diagnostics) -> Result<(), Error> {
    let place = path.to_string_lossy();
    if points.origin != glam::DVec3::ZERO {
        let message = "positions are single precision from the world's origin: digits may be lost";
        diagnostics.warn("lost", place.clone(), message);
    }
    let is_large = |i: &i32| i.unsigned_abs() > 1 << 24;
    let whole = points
        .columns
        .iter()
        .filter_map(|column| match &column.values {
            ColumnValues::Ints(values) if values.iter().any(is_large) => Some(&column.name),
            _ => None,
        });
    for name in whole {
        let message = format!("{name} has whole numbers beyond 2^24, which floats round");
        diagnostics.warn("lost", place.clone(), message);
    }
    let origin = points.origin.as_vec3();
    let written = write_streamed(path, |out| {
        out.write_all(&header(points, origin))?;
        let chunks = points.len().div_ceil(CHUNK);
        for first in (0..chunks).step_by(CHUNKS) {
            let block: Vec<Vec<u8>> = (first..chunks.min(first + CHUNKS))
                .into_par_iter()
                .map(|chunk| {
                    rows(
                        points,
                        origin,
                        chunk * CHUNK..points.len().min((chunk + 1) * CHUNK),
                    )
                })
                .collect();
            block.iter().try_for_each(|bytes| out.write_all(bytes))?;
        }
        Ok(())
    });
    written.map_err(|source| Error::Unwritable {
        path: path.to_owned(),
        source,
    })
}

#[expect(
    clippy::cast_precision_loss,
    reason = "the format counts in double precision"
)]
fn header(points: &PointSet, origin: Vec3) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    let mut put = |part: &[u8]| bytes.extend_from_slice(part);
    put(&0_i32.to_le_bytes());
    put(&(points.len() as f64).to_le_bytes());
    let low = points
        .position
        .iter()
        .copied()
        .reduce(Vec3::min)
        .unwrap_or_default()
        + origin;
    let high = points
        .position
        .iter()
        .copied()
        .reduce(Vec3::max)
        .unwrap_or_default()
        + origin;
    let identity = glam::Mat4::IDENTITY.to_cols_array();
    let numbers = low.to_array().into_iter().chain(high.to_array());
    let numbers = numbers.chain(identity).chain(identity).chain(IMAGE);
    numbers.for_each(|number| put(&number.to_le_bytes()));
    let specs: Vec<(&str, usize, &str)> = points
        .columns
        .iter()
        .map(|column| match &column.values {
            ColumnValues::Floats(_) | ColumnValues::Ints(_) => ("float", 1, column.name.as_str()),
            ColumnValues::Vectors(VectorKind::Color, _) => ("color", 3, column.name.as_str()),
            ColumnValues::Vectors(VectorKind::Normal, _) => ("normal", 3, column.name.as_str()),
            ColumnValues::Vectors(VectorKind::Vector, _) => ("vector", 3, column.name.as_str()),
        })
        .collect();
    let count = |count: usize| i32::try_from(count).unwrap_or(i32::MAX).to_le_bytes();
    put(&count(specs.len()));
    put(&count(specs.iter().map(|(_, width, _)| width).sum()));
    for (type_name, _, name) in specs {
        let name = name.replace(['\n', ' '], "_");
        put(format!("{type_name} _{name}\n").as_bytes());
    }
    bytes
}

#[expect(clippy::cast_precision_loss, reason = "told of where it loses")]
fn rows(points: &PointSet, origin: Vec3, range: std::ops::Range<usize>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for i in range {
        let mut put = |number: f32| bytes.extend_from_slice(&number.to_le_bytes());
        (points.position[i] + origin)
            .to_array()
            .into_iter()
            .for_each(&mut put);
        let normal = points
            .normal
            .as_ref()
            .map_or(Vec3::ZERO, |normals| normals[i]);
        let codes = encode_normal(normal);
        bytes.extend(codes.into_iter().flat_map(u16::to_le_bytes));
        let mut put = |number: f32| bytes.extend_from_slice(&number.to_le_bytes());
        put(points.radius.as_ref().map_or(0.0, |radii| radii[i]));
        for column in &points.columns {
            match &column.values {
                ColumnValues::Floats(values) => put(values[i]),
                ColumnValues::Ints(values) => put(values[i] as f32),
                ColumnValues::Vectors(_, values) => {
                    values[i].to_array().into_iter().for_each(&mut put);
                }
            }
        }
    }
    bytes
}

/// Angle about z from y, −π…π, and height, −1…1, each in 16 bits.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0…65535"
)]
fn encode_normal(normal: Vec3) -> [u16; 2] {
    if normal == Vec3::ZERO {
        return NO_NORMAL;
    }
    let whole = f32::from(u16::MAX);
    let code = |part: f32| (part * whole + 0.5).clamp(0.0, whole) as u16;
    let angle = code(normal.x.atan2(normal.y) / TAU + 0.5);
    let height = code(0.5 * (normal.normalize_or_zero().z + 1.0));
    // straight up any angle will do: the pair of highest codes means none
    match [angle, height] == NO_NORMAL {
        true => [0, height],
        false => [angle, height],
    }
}

fn decode_normal(codes: [u16; 2]) -> Vec3 {
    if codes == NO_NORMAL {
        return Vec3::ZERO;
    }
    let [angle, height] = codes.map(|code| f32::from(code) / f32::from(u16::MAX));
    let angle = TAU * angle - PI;
    let z = 2.0 * height - 1.0;
    let level = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(level * angle.sin(), level * angle.cos(), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_come_back_to_a_few_thousandths_of_a_degree() {
        let mut worst = 0.0_f32;
        for i in 0..2000_u16 {
            // a spiral over the sphere
            let z = 1.0 - (f32::from(i) + 0.5) / 1000.0;
            let turn = 2.4 * f32::from(i);
            let level = (1.0 - z * z).sqrt();
            let normal = Vec3::new(level * turn.cos(), level * turn.sin(), z);
            let back = decode_normal(encode_normal(normal));
            worst = worst.max((back - normal).length());
        }
        // steps of 2/65535 in height are steep near the poles
        assert!(worst < 1e-3, "{worst}");
        for axis in [
            Vec3::X,
            Vec3::Y,
            Vec3::Z,
            Vec3::NEG_X,
            Vec3::NEG_Y,
            Vec3::NEG_Z,
        ] {
            assert!(
                (decode_normal(encode_normal(axis)) - axis).length() < 1e-4,
                "{axis}"
            );
        }
        assert_eq!(decode_normal(encode_normal(Vec3::ZERO)), Vec3::ZERO);
    }
}
