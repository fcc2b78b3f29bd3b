//! Accessors → numbers: any component type, normalized or not, interleaved, sparse; nothing is read outside of buffers.

use super::document::Document;
use gltf::Accessor;
use gltf::accessor::{DataType, Dimensions};

/// Most values of an accessor without data, which are all 0: files may claim any number.
const MOST_ZEROS: usize = 1 << 26;

/// Numbers of an accessor of `dimensions`, `dimensions.multiplicity()` a value. Integers are scaled where they are
/// normalized.
pub(super) fn numbers(
    document: &Document,
    accessor: &Accessor<'_>,
    dimensions: &[Dimensions],
) -> Result<Vec<f32>, String> {
    let wrong = |what: &str| format!("accessor {} {what}", accessor.index());
    if !dimensions.contains(&accessor.dimensions()) {
        return Err(wrong(&format!(
            "is {:?} where {dimensions:?} is needed",
            accessor.dimensions()
        )));
    }
    let width = accessor.dimensions().multiplicity();
    let mut values = match accessor.view() {
        Some(view) => {
            let rows = Rows::new(document, &view, accessor)?;
            let mut values = Vec::with_capacity(accessor.count() * width);
            for row in 0..accessor.count() {
                rows.push(row, &mut values);
            }
            values
        }
        None if accessor.count() > MOST_ZEROS => {
            return Err(wrong("has no data and too many values"));
        }
        None => vec![0.0; accessor.count() * width],
    };
    if let Some(sparse) = accessor.sparse() {
        replace(document, accessor, &sparse, &mut values)?;
    }
    match values.iter().any(|value| !value.is_finite()) {
        true => Err(wrong("holds numbers that are not finite")),
        false => Ok(values),
    }
}

/// Values of an accessor of whole numbers.
pub(super) fn indices(document: &Document, accessor: &Accessor<'_>) -> Result<Vec<u32>, String> {
    let view = accessor
        .view()
        .ok_or_else(|| format!("accessor {} has no data", accessor.index()))?;
    if accessor.dimensions() != Dimensions::Scalar {
        return Err(format!(
            "accessor {} is no list of indices",
            accessor.index()
        ));
    }
    let rows = Rows::new(document, &view, accessor)?;
    (0..accessor.count()).map(|row| rows.index(row)).collect()
}

/// The values of an accessor where they lie.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    width: usize,
    kind: DataType,
    is_normalized: bool,
}

impl<'a> Rows<'a> {
    fn new(
        document: &'a Document,
        view: &gltf::buffer::View<'_>,
        accessor: &Accessor<'_>,
    ) -> Result<Self, String> {
        let (kind, width) = (accessor.data_type(), accessor.dimensions().multiplicity());
        let layout = (kind, width, accessor.normalized());
        let stride = view.stride().unwrap_or(accessor.size());
        Self::within(
            document,
            (view, accessor.offset()),
            layout,
            (accessor.count(), stride),
        )
        .map_err(|message| format!("accessor {}: {message}", accessor.index()))
    }

    fn within(
        document: &'a Document,
        (view, offset): (&gltf::buffer::View<'_>, usize),
        (kind, width, is_normalized): (DataType, usize, bool),
        (count, stride): (usize, usize),
    ) -> Result<Self, String> {
        let bytes = document.view(view)?;
        let size = kind.size() * width;
        let last = count
            .checked_sub(1)
            .map_or(Some(0), |last| last.checked_mul(stride));
        let needed = last.and_then(|last| last.checked_add(if count > 0 { size } else { 0 }));
        let end = needed.and_then(|needed| needed.checked_add(offset));
        match end.filter(|&end| end <= bytes.len()) {
            Some(end) => Ok(Self {
                bytes: &bytes[offset.min(end)..end],
                stride,
                width,
                kind,
                is_normalized,
            }),
            None => Err(format!(
                "{count} values of {size} bytes, {stride} apart, from byte {offset} do not fit the {} bytes of bufferView {}",
                bytes.len(),
                view.index()
            )),
        }
    }

    /// `N` bytes of component `k` of value `row`.
    fn part<const N: usize>(&self, row: usize, k: usize) -> [u8; N] {
        let at = row * self.stride + k * N;
        let mut part = [0; N];
        part.copy_from_slice(&self.bytes[at..at + N]);
        part
    }

    #[expect(clippy::cast_precision_loss, reason = "indices are read as such")]
    fn push(&self, row: usize, values: &mut Vec<f32>) {
        for k in 0..self.width {
            let (value, whole) = match self.kind {
                DataType::I8 => (f32::from(i8::from_le_bytes(self.part(row, k))), 127.0),
                DataType::U8 => (f32::from(u8::from_le_bytes(self.part(row, k))), 255.0),
                DataType::I16 => (f32::from(i16::from_le_bytes(self.part(row, k))), 32_767.0),
                DataType::U16 => (f32::from(u16::from_le_bytes(self.part(row, k))), 65_535.0),
                DataType::U32 => (
                    u32::from_le_bytes(self.part(row, k)) as f32,
                    4_294_967_295.0,
                ),
                DataType::F32 => (f32::from_le_bytes(self.part(row, k)), 1.0),
            };
            let is_scaled = self.is_normalized && self.kind != DataType::F32;
            values.push(if is_scaled {
                (value / whole).max(-1.0)
            } else {
                value
            });
        }
    }

    fn index(&self, row: usize) -> Result<u32, String> {
        Ok(match self.kind {
            DataType::U8 => u8::from_le_bytes(self.part(row, 0)).into(),
            DataType::U16 => u16::from_le_bytes(self.part(row, 0)).into(),
            DataType::U32 => u32::from_le_bytes(self.part(row, 0)),
            other => return Err(format!("indices are {other:?}, not whole numbers from 0")),
        })
    }
}

/// Put the values of a sparse accessor in place.
fn replace(
    document: &Document,
    accessor: &Accessor<'_>,
    sparse: &gltf::accessor::sparse::Sparse<'_>,
    values: &mut [f32],
) -> Result<(), String> {
    use gltf::accessor::sparse::IndexType;
    let width = accessor.dimensions().multiplicity();
    let (indices, new) = (sparse.indices(), sparse.values());
    let kind = match indices.index_type() {
        IndexType::U8 => DataType::U8,
        IndexType::U16 => DataType::U16,
        IndexType::U32 => DataType::U32,
    };
    let place = (indices.view(), indices.offset());
    let rows = Rows::within(
        document,
        (&place.0, place.1),
        (kind, 1, false),
        (sparse.count(), kind.size()),
    )?;
    let place = (new.view(), new.offset());
    let layout = (accessor.data_type(), width, accessor.normalized());
    let from = Rows::within(
        document,
        (&place.0, place.1),
        layout,
        (sparse.count(), accessor.size()),
    )?;
    let mut value = Vec::with_capacity(width);
    for row in 0..sparse.count() {
        let at = rows.index(row)? as usize * width;
        value.clear();
        from.push(row, &mut value);
        let target = values.get_mut(at..at + width);
        target
            .ok_or("a sparse accessor replaces values that are not there")?
            .copy_from_slice(&value);
    }
    Ok(())
}
