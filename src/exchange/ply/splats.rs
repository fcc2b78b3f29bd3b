//! 3D Gaussian splats ↔ PLY, as the reference implementation of their authors writes them.
//!
//! | | PLY | here |
//! |---|---|---|
//! | opacity | `opacity`, logit | 1 / (1 + e⁻ˣ) |
//! | scale | `scale_0…2`, logarithm | eˣ |
//! | rotation | `rot_0…3`, w first, any length | unit |
//! | color | `f_dc_0…2`; `f_rest_i`: all of red, of green, of blue | a color for each coefficient |

use super::header::Header;
use super::table::Table;
use super::write::made_by;
use crate::exchange::{Error, malformed, read_file};
use crate::surfels::splats::Splats;
use crate::writers::usd::Provenance;
use crate::writers::write_streamed;
use glam::{Quat, Vec3};
use std::path::Path;

/// Opacities are kept this far from 0 and 1, where their logits are infinite.
const OPAQUE: f32 = 1e-6;

/// Smallest scale whose logarithm is written.
const SMALLEST: f32 = 1e-30;

/// Rows in memory at a time.
const BLOCK: usize = 65_536;

/// True if the file at `path` is a PLY of splats.
pub fn is_splats(path: &Path) -> bool {
    use std::io::Read;
    /// Headers of splats have 62 lines.
    const LONGEST: u64 = 1 << 16;
    let mut start = Vec::new();
    let read =
        std::fs::File::open(path).and_then(|file| file.take(LONGEST).read_to_end(&mut start));
    let header = read.ok().and_then(|_| Header::parse(&start).ok());
    header.is_some_and(|header| {
        header.elements.iter().any(|element| {
            let name = |property: &super::header::Property| match property {
                super::header::Property::One(name, _) => name == "f_dc_0",
                super::header::Property::List(..) => false,
            };
            element.name == "vertex" && element.properties.iter().any(name)
        })
    })
}

/// The splats of the file at `path`.
///
/// # Errors
/// Files that are no PLY, lack a property, or hold values that are not finite.
pub fn read(path: &Path) -> Result<Splats, Error> {
    let bytes = read_file(path)?;
    let malformed = malformed(path);
    let header = Header::parse(&bytes).map_err(&malformed)?;
    let table = Table::of(&header, "vertex", &bytes).map_err(&malformed)?;
    splats(&table).map_err(&malformed)
}

fn splats(table: &Table<'_>) -> Result<Splats, String> {
    let find = |name: &str| {
        table
            .find(name)
            .ok_or_else(|| format!("its splats have no {name}"))
    };
    let three = |names: [&str; 3]| -> Result<Vec<Vec3>, String> {
        let [x, y, z] = names.map(find);
        Ok(table.vectors([x?, y?, z?]))
    };
    let rest = (0..)
        .take_while(|i| table.find(&format!("f_rest_{i}")).is_some())
        .count();
    let degree = (0..=Splats::MOST_DEGREE).find(|degree| 3 * ((degree + 1).pow(2) - 1) == rest);
    let degree = degree.ok_or_else(|| format!("it has {rest} f_rest, not 0, 9, 24 or 45"))?;
    let [w, x, y, z] =
        ["rot_0", "rot_1", "rot_2", "rot_3"].map(|name| find(name).map(|at| table.floats(at)));
    let (w, x, y, z) = (w?, x?, y?, z?);
    let turn = |i: usize| {
        let turn = Quat::from_xyzw(x[i], y[i], z[i], w[i]);
        if turn.length_squared() > 0.0 {
            turn.normalize()
        } else {
            Quat::IDENTITY
        }
    };
    let logit = table.floats(find("opacity")?);
    let scale = three(["scale_0", "scale_1", "scale_2"])?;
    let mut splats = Splats {
        position: three(["x", "y", "z"])?,
        orientation: (0..table.count).map(turn).collect(),
        scale: scale.into_iter().map(|log| log.map(f32::exp)).collect(),
        opacity: logit
            .into_iter()
            .map(|x| 1.0 / (1.0 + (-x).exp()))
            .collect(),
        degree,
        coefficients: Vec::new(),
    };
    let width = splats.width();
    let mut coefficients = vec![Vec3::ZERO; table.count * width];
    let mut put = |k: usize, colors: Vec<Vec3>| {
        for (i, color) in colors.into_iter().enumerate() {
            coefficients[i * width + k] = color;
        }
    };
    put(0, three(["f_dc_0", "f_dc_1", "f_dc_2"])?);
    for k in 1..width {
        let names = [0, 1, 2].map(|channel| format!("f_rest_{}", channel * (width - 1) + k - 1));
        put(k, three(names.each_ref().map(String::as_str))?);
    }
    splats.coefficients = coefficients;
    check(&splats)?;
    Ok(splats)
}

fn check(splats: &Splats) -> Result<(), String> {
    let is_bad = |i: usize| {
        let width = splats.width();
        let numbers = [splats.position[i], splats.scale[i]];
        let finite = numbers
            .iter()
            .chain(&splats.coefficients[i * width..(i + 1) * width]);
        !finite.into_iter().all(|v| v.is_finite())
            || !splats.opacity[i].is_finite()
            || !splats.orientation[i].is_finite()
    };
    match (0..splats.len()).find(|&i| is_bad(i)) {
        Some(i) => Err(format!("splat {i} has values that are not finite")),
        None => Ok(()),
    }
}

/// Write `splats` to `path`, binary.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write(splats: &Splats, path: &Path, provenance: &Provenance) -> Result<(), Error> {
    let rest = 3 * (splats.width() - 1);
    let fixed = [
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2",
    ]
    .map(str::to_owned);
    let last = [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ];
    let names = fixed
        .into_iter()
        .chain((0..rest).map(|i| format!("f_rest_{i}")));
    let names = names
        .chain(last.map(str::to_owned))
        .map(|name| format!("property float {name}\n"));
    let header = format!(
        "ply\nformat binary_little_endian 1.0\n{}element vertex {}\n{}end_header\n",
        made_by(provenance),
        splats.len(),
        names.collect::<String>()
    );
    let written = write_streamed(path, |out| {
        out.write_all(header.as_bytes())?;
        let mut numbers: Vec<f32> = Vec::new();
        for first in (0..splats.len()).step_by(BLOCK) {
            numbers.clear();
            for i in first..splats.len().min(first + BLOCK) {
                row(splats, i, &mut numbers);
            }
            let bytes: Vec<u8> = numbers
                .iter()
                .flat_map(|number| number.to_le_bytes())
                .collect();
            out.write_all(&bytes)?;
        }
        Ok(())
    });
    written.map_err(|source| Error::Unwritable {
        path: path.to_owned(),
        source,
    })
}

fn row(splats: &Splats, i: usize, numbers: &mut Vec<f32>) {
    let width = splats.width();
    let colors = &splats.coefficients[i * width..(i + 1) * width];
    numbers.extend(splats.position[i].to_array());
    numbers.extend([0.0; 3]);
    numbers.extend(colors[0].to_array());
    for channel in 0..3 {
        numbers.extend(colors[1..].iter().map(|color| color[channel]));
    }
    let opacity = splats.opacity[i].clamp(OPAQUE, 1.0 - OPAQUE);
    numbers.push((opacity / (1.0 - opacity)).ln());
    numbers.extend(
        splats.scale[i]
            .to_array()
            .map(|scale| scale.max(SMALLEST).ln()),
    );
    let turn = splats.orientation[i];
    numbers.extend([turn.w, turn.x, turn.y, turn.z]);
}
