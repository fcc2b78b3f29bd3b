//! Points as files hold them: positions and any number of named columns. Where a [`super::SurfelCloud`] knows what each
//! of its columns means, these are carried along as they are: to be looked at, or into another format.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Values looked at by one thread at a time.
const CHUNK: usize = 1 << 16;

/// Points as columns of equal length; world space relative to `origin`.
///
/// Promises: finite positions; normals of unit length, or zero where the file has none that makes sense; `radius >= 0`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointSet {
    /// World position that `position` is relative to.
    pub origin: DVec3,
    /// Positions.
    pub position: Vec<Vec3>,
    /// Directions that the points face.
    pub normal: Option<Vec<Vec3>>,
    /// Radii, stage units.
    pub radius: Option<Vec<f32>>,
    /// Everything else, each name once.
    pub columns: Vec<Column>,
}

/// One named value a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// As USD names primvars, without the prefix: `displayColor`, `irradiance`, `occlusion`.
    pub name: String,
    /// One a point.
    pub values: ColumnValues,
}

/// Values of a [`Column`].
#[derive(Debug, Clone, PartialEq)]
pub enum ColumnValues {
    /// Numbers.
    Floats(Vec<f32>),
    /// Whole numbers.
    Ints(Vec<i32>),
    /// Three numbers.
    Vectors(VectorKind, Vec<Vec3>),
}

/// What the three numbers of a vector mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VectorKind {
    /// Linear Rec.709.
    Color,
    /// A direction, unit.
    Normal,
    /// Anything else.
    Vector,
}

impl ColumnValues {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Floats(values) => values.len(),
            Self::Ints(values) => values.len(),
            Self::Vectors(_, values) => values.len(),
        }
    }

    /// True without values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl PointSet {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True without points.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// The column called `name`.
    pub fn column(&self, name: &str) -> Option<&ColumnValues> {
        let mut columns = self.columns.iter();
        columns
            .find(|column| column.name == name)
            .map(|column| &column.values)
    }

    /// The column called `name`, if it has three numbers a point.
    pub fn vectors(&self, name: &str) -> Option<&[Vec3]> {
        match self.column(name) {
            Some(ColumnValues::Vectors(_, values)) => Some(values),
            _ => None,
        }
    }

    /// The column called `name`, if it has one number a point.
    pub fn floats(&self, name: &str) -> Option<&[f32]> {
        match self.column(name) {
            Some(ColumnValues::Floats(values)) => Some(values),
            _ => None,
        }
    }

    /// Add the points of `other`, which has the same origin. Columns that one of the two lacks are 0 there; returns their
    /// names. A column of another type than ours of that name is taken for a lacking one.
    pub fn append(&mut self, other: Self) -> Vec<String> {
        let (before, more) = (self.len(), other.len());
        let mut lacking = Vec::new();
        self.position.extend(other.position);
        join(&mut self.normal, other.normal, (before, more), Vec3::ZERO);
        join(&mut self.radius, other.radius, (before, more), 0.0);
        let mut theirs = other.columns;
        for column in &mut self.columns {
            let found = theirs.iter().position(|other| other.name == column.name);
            let same = found.map(|at| theirs.swap_remove(at).values);
            if !column.values.extend(same, more) {
                lacking.push(column.name.clone());
            }
        }
        for mut column in theirs {
            let mut values = column.values.zeros(before);
            values.extend(Some(column.values), more);
            column.values = values;
            lacking.push(column.name.clone());
            self.columns.push(column);
        }
        lacking
    }
}

impl PointSet {
    /// Put 0 in place of values of columns, radii and normals that are not finite; returns how many there were.
    pub fn remove_non_finite(&mut self) -> usize {
        let columns = self.columns.iter_mut();
        let mut bad: usize = columns
            .map(|column| column.values.remove_non_finite())
            .sum();
        if let Some(radii) = &mut self.radius {
            bad += zeroed(radii, 0.0, |radius| radius.is_finite());
        }
        if let Some(normals) = &mut self.normal {
            bad += zeroed(normals, Vec3::ZERO, |normal| normal.is_finite());
        }
        bad
    }
}

impl ColumnValues {
    /// Put 0 in place of values that are not finite; returns how many there were.
    pub fn remove_non_finite(&mut self) -> usize {
        match self {
            Self::Floats(values) => zeroed(values, 0.0, |value| value.is_finite()),
            Self::Vectors(_, values) => zeroed(values, Vec3::ZERO, |value| value.is_finite()),
            Self::Ints(_) => 0,
        }
    }

    fn zeros(&self, count: usize) -> Self {
        match self {
            Self::Floats(_) => Self::Floats(vec![0.0; count]),
            Self::Ints(_) => Self::Ints(vec![0; count]),
            Self::Vectors(kind, _) => Self::Vectors(*kind, vec![Vec3::ZERO; count]),
        }
    }

    /// Add `more` values, zeros unless `other` has them; false if it has not.
    fn extend(&mut self, other: Option<Self>, more: usize) -> bool {
        match (self, other) {
            (Self::Floats(ours), Some(Self::Floats(theirs))) => ours.extend(theirs),
            (Self::Ints(ours), Some(Self::Ints(theirs))) => ours.extend(theirs),
            (Self::Vectors(_, ours), Some(Self::Vectors(_, theirs))) => ours.extend(theirs),
            (ours, _) => {
                let length = ours.len() + more;
                match ours {
                    Self::Floats(ours) => ours.resize(length, 0.0),
                    Self::Ints(ours) => ours.resize(length, 0),
                    Self::Vectors(_, ours) => ours.resize(length, Vec3::ZERO),
                }
                return false;
            }
        }
        true
    }
}

/// Put `zero` in place of values that are not fine; returns how many there were.
fn zeroed<T: Copy + Send + Sync>(
    values: &mut [T],
    zero: T,
    is_fine: impl Fn(&T) -> bool + Sync,
) -> usize {
    let in_chunk = |values: &mut [T]| {
        // without an early end it is done many at a time
        if values.iter().fold(true, |all, value| all & is_fine(value)) {
            return 0;
        }
        let mut bad = 0;
        for value in values.iter_mut().filter(|value| !is_fine(value)) {
            (*value, bad) = (zero, bad + 1);
        }
        bad
    };
    values.par_chunks_mut(CHUNK).map(in_chunk).sum()
}

/// Index of the first value that is not fine.
pub(crate) fn first_bad<T: Sync>(
    values: &[T],
    is_fine: impl Fn(&T) -> bool + Sync,
) -> Option<usize> {
    const CHUNK: usize = 1 << 14;
    // without an early end it is done many at a time
    let is_bad = |chunk: &[T]| !chunk.iter().fold(true, |all, value| all & is_fine(value));
    let chunk = values.par_chunks(CHUNK).position_first(is_bad)?;
    let start = chunk * CHUNK;
    let within = values[start..].iter().position(|value| !is_fine(value));
    within.map(|within| start + within)
}

fn join<T: Copy>(
    ours: &mut Option<Vec<T>>,
    theirs: Option<Vec<T>>,
    (before, more): (usize, usize),
    zero: T,
) {
    if ours.is_none() && theirs.is_none() {
        return;
    }
    let values = ours.get_or_insert_with(|| vec![zero; before]);
    values.extend(theirs.unwrap_or_else(|| vec![zero; more]));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(count: u8, columns: &[(&str, ColumnValues)]) -> PointSet {
        PointSet {
            position: (0..count).map(|i| Vec3::splat(f32::from(i))).collect(),
            columns: columns
                .iter()
                .map(|(name, values)| Column {
                    name: (*name).to_owned(),
                    values: values.clone(),
                })
                .collect(),
            ..PointSet::default()
        }
    }

    #[test]
    fn what_one_part_lacks_is_zero_there_and_told() {
        let mut all = set(
            2,
            &[
                ("a", ColumnValues::Floats(vec![1.0, 2.0])),
                ("b", ColumnValues::Ints(vec![7, 8])),
            ],
        );
        let mut other = set(
            1,
            &[
                ("b", ColumnValues::Ints(vec![9])),
                ("c", ColumnValues::Floats(vec![5.0])),
            ],
        );
        other.radius = Some(vec![3.0]);
        assert_eq!(all.append(other), ["a", "c"]);
        assert_eq!(all.floats("a"), Some(&[1.0, 2.0, 0.0][..]));
        assert_eq!(all.column("b"), Some(&ColumnValues::Ints(vec![7, 8, 9])));
        assert_eq!(all.floats("c"), Some(&[0.0, 0.0, 5.0][..]));
        assert_eq!(all.radius, Some(vec![0.0, 0.0, 3.0]));
        assert_eq!(all.len(), 3);
    }
}
