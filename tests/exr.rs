//! EXR files as OpenEXR, OpenImageIO and the `exr` crate read them: types, values, headers, parts.

#[path = "support/python.rs"]
mod python;

use glam::DMat4;
use std::collections::BTreeMap;
use std::path::PathBuf;
use surflux::results::{Aov, AovImage};
use surflux::writers::image::{Error, ExrInfo, ExrLayout, write_exr};

fn image(aov: Aov, value: impl Fn(usize, usize) -> f32) -> AovImage {
    let (width, height) = (5, 3);
    let components = aov.components();
    let data = (0..width * height * components).map(|i| value(i / components, i % components));
    AovImage {
        aov,
        group: None,
        width: 5,
        height: 3,
        data: data.collect(),
    }
}

/// `color` beyond the range of halves, exact floats, ids with nothing.
fn images() -> Vec<AovImage> {
    vec![
        image(Aov::Color, |pixel, c| {
            if pixel == 0 {
                1e6
            } else {
                pixel as f32 + 0.25 * c as f32
            }
        }),
        image(Aov::DiffuseIndirect, |pixel, c| {
            0.5 * pixel as f32 + c as f32
        }),
        image(Aov::Occlusion, |pixel, _| pixel as f32 / 3.0),
        image(Aov::Depth, |pixel, _| {
            if pixel == 0 { 1e10 } else { pixel as f32 / 3.0 }
        }),
        image(Aov::Normal, |_, c| [0.6, 0.0, 0.8][c]),
        image(Aov::PrimId, |pixel, _| pixel as f32 - 1.0),
        image(Aov::VisibilitySh, |pixel, c| pixel as f32 - c as f32),
        image(Aov::RadianceSh, |pixel, c| pixel as f32 - 100.5 * c as f32),
    ]
}

fn info() -> ExrInfo {
    ExrInfo {
        pixel_aspect_ratio: 2.0,
        world_to_camera: Some(DMat4::from_translation(glam::DVec3::new(1.0, 2.0, 3.0))),
        world_to_ndc: Some(DMat4::from_scale(glam::DVec3::new(4.0, 5.0, 6.0))),
        clipping_range: Some((0.5, f64::INFINITY)),
        frames_per_second: Some(23.976),
        software: "surflux test".into(),
        texts: BTreeMap::from([
            ("usd/stage".into(), "/scènes/a.usda".into()),
            ("surflux/command".into(), "surflux render a.usda".into()),
        ]),
    }
}

fn written(layout: ExrLayout) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("out.exr");
    write_exr(&path, &images(), &info(), layout).expect("written");
    (folder, path)
}

#[test]
fn one_part_reads_in_openexr_with_the_types_values_and_headers_of_the_contract() {
    let (_folder, path) = written(ExrLayout::SinglePart);
    python::run_python(
        r#"
import sys, numpy as np, OpenEXR
file = OpenEXR.File(sys.argv[1], separate_channels=True)
assert len(file.parts) == 1
header, channels = file.header(), file.channels()
kinds = {name: str(c.pixels.dtype) for name, c in channels.items()}
expected = {n: "float16" for n in ["R", "G", "B", "A", "diffuse_indirect.R", "diffuse_indirect.G", "diffuse_indirect.B"]}
expected |= {n: "float32" for n in ["occlusion.Y", "depth.Z", "N.X", "N.Y", "N.Z"] + [f"visibility_sh{k}.Y" for k in range(9)] + [f"radiance_sh{k}.{c}" for k in range(9) for c in "RGB"]} | {"primId.id": "uint32"}
assert kinds == expected, kinds
pixel = np.arange(15).reshape(3, 5)
get = lambda name: channels[name].pixels
assert get("R")[0, 0] == 65504 and (get("G").ravel()[1:] == pixel.ravel()[1:] + 0.25).all()
assert (get("diffuse_indirect.B") == 0.5 * pixel + 2).all()
assert (get("occlusion.Y") == (pixel / np.float32(3)).astype("f4")).all()
assert get("depth.Z")[0, 0] == np.float32(1e10) and get("N.Z")[1, 1] == np.float32(0.8)
assert all((get(f"visibility_sh{k}.Y") == pixel - k).all() for k in range(9))
assert all((get(f"radiance_sh{k}.{c}") == pixel - 100.5 * (3 * k + i)).all() for k in range(9) for i, c in enumerate("RGB"))
assert get("primId.id")[0, 0] == 0xFFFFFFFF and get("primId.id")[2, 4] == 13
assert header["compression"] == OpenEXR.ZIP_COMPRESSION, header["compression"]
assert header["pixelAspectRatio"] == 2
assert np.allclose(header["chromaticities"], (.64, .33, .30, .60, .15, .06, .3127, .3290))
assert (np.array(header["worldToCamera"]).reshape(4, 4)[3] == [1, 2, 3, 1]).all()
assert (np.diag(np.array(header["worldToNDC"]).reshape(4, 4)) == [4, 5, 6, 1]).all()
rate = header["framesPerSecond"]
assert str(rate).replace(" ", "") in ("24000/1001", "(24000,1001)") or (rate.n, rate.d) == (24000, 1001), rate
assert header["software"] == "surflux test" and header["usd/stage"] == "/scènes/a.usda"
assert header["surflux/command"] == "surflux render a.usda" and header["colorInteropID"] == "lin_rec709_scene"
assert tuple(header["dataWindow"][1]) == (4, 2) and tuple(header["displayWindow"][1]) == (4, 2)
"#,
        &[path],
    );
}

#[test]
fn openimageio_finds_formats_and_alpha() {
    let (_folder, path) = written(ExrLayout::SinglePart);
    python::run_python(
        r#"
import sys, OpenImageIO as oiio
file = oiio.ImageInput.open(sys.argv[1])
spec = file.spec()
assert spec.nchannels == 49 and list(spec.channelnames[:4]) == ["R", "G", "B", "A"], spec.channelnames
assert spec.alpha_channel == 3
formats = {n: str(spec.channelformat(i)) for i, n in enumerate(spec.channelnames)}
assert formats["R"] == "half" and formats["N.X"] == "float" and formats["primId.id"] == "uint"
assert not file.seek_subimage(1, 0)
"#,
        &[path],
    );
}

#[test]
fn several_parts_are_named_like_their_aovs() {
    let (_folder, path) = written(ExrLayout::MultiPart);
    python::run_python(
        r#"
import sys, OpenEXR, OpenImageIO as oiio
file = OpenEXR.File(sys.argv[1], separate_channels=True)
names = [part.header["name"] for part in file.parts]
assert names == ["color", "diffuse_indirect", "occlusion", "depth", "N", "primId", "visibility_sh", "radiance_sh"], names
ids = [part.header["colorInteropID"] for part in file.parts]
assert ids == ["lin_rec709_scene"] * 2 + ["data"] * 6, ids
assert sorted(file.parts[4].channels) == ["N.X", "N.Y", "N.Z"] and sorted(file.parts[0].channels) == ["A", "B", "G", "R"]
assert file.parts[5].channels["primId.id"].pixels[2, 4] == 13
image = oiio.ImageInput.open(sys.argv[1])
assert image.seek_subimage(5, 0) and image.spec().getattribute("oiio:subimagename") == "primId"
"#,
        &[path],
    );
}

#[test]
fn equal_images_are_equal_files() {
    for layout in [ExrLayout::SinglePart, ExrLayout::MultiPart] {
        let (_folder, first) = written(layout);
        let first = std::fs::read(first).unwrap();
        for _ in 0..4 {
            let (_folder, again) = written(layout);
            assert_eq!(std::fs::read(again).unwrap(), first);
        }
    }
}

#[test]
fn the_exr_crate_reads_back_what_was_written() {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    for (layout, layers) in [(ExrLayout::SinglePart, 1), (ExrLayout::MultiPart, 8)] {
        let (_folder, path) = written(layout);
        let read = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .all_layers()
            .all_attributes();
        let image = read.from_file(&path).unwrap();
        assert_eq!(image.layer_data.len(), layers);
        let channels = image
            .layer_data
            .iter()
            .flat_map(|layer| &layer.channel_data.list);
        let depth = channels
            .clone()
            .find(|c| c.name.to_string() == "depth.Z")
            .unwrap();
        assert_eq!(depth.sample_data.values_as_f32().last(), Some(14.0 / 3.0));
        assert_eq!(channels.count(), 49);
    }
}

#[test]
fn what_cannot_be_an_image_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.exr");
    let small = AovImage {
        aov: Aov::Depth,
        group: None,
        width: 1,
        height: 1,
        data: vec![0.0],
    };
    let empty = AovImage {
        aov: Aov::Depth,
        group: None,
        width: 0,
        height: 1,
        data: vec![],
    };
    for images in [vec![], vec![empty], [images(), vec![small]].concat()] {
        let result = write_exr(&path, &images, &ExrInfo::default(), ExrLayout::SinglePart);
        assert!(matches!(result, Err(Error::Unsuitable { .. })));
    }
    assert!(!path.exists());
}
