//! Looks in MaterialX files: prims that reference a `.mtlx` document get the Material, `NodeGraph` and Shader prims that
//! USD's own MaterialX plug-in would compose there. The usd-core of `PyPI` and the native door lack that plug-in; where
//! a studio's USD has it, the prims are there already and stay as they are.

mod document;

use super::raw::{MaterialxReference, RawPrim, RawStage};
use crate::diagnostics::Diagnostics;
use crate::files::package;
use document::Document;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Larger documents than this, bytes, are refused: those of production assets have some kilobytes.
const LARGEST_DOCUMENT: u64 = 64 << 20;

/// True for the name of a MaterialX document, in any case.
pub fn is_document(asset: &str) -> bool {
    let extension = Path::new(asset).extension();
    extension.is_some_and(|extension| extension.eq_ignore_ascii_case("mtlx"))
}

/// `raw` with the materials of the documents that its prims reference. Documents that cannot be read, and targets that
/// they do not have, give a warning.
pub(super) fn graft(mut raw: RawStage, diagnostics: &Diagnostics) -> RawStage {
    if raw.prims.iter().all(|prim| prim.materialx.is_empty()) {
        return raw;
    }
    let mut documents: HashMap<PathBuf, Option<String>> = HashMap::new();
    let mut taken: HashSet<String> = raw.prims.iter().map(|prim| prim.path.clone()).collect();
    let mut grafts: Vec<Vec<RawPrim>> = vec![Vec::new(); raw.prims.len()];
    for (prim, graft) in raw.prims.iter_mut().zip(&mut grafts) {
        for reference in std::mem::take(&mut prim.materialx) {
            let text = documents
                .entry(reference.file.clone())
                .or_insert_with(|| read(&reference, &prim.path, diagnostics));
            let Some(text) = text else { continue };
            match added(text, &reference, prim) {
                Ok(added) => {
                    graft.extend(
                        added
                            .into_iter()
                            .filter(|new| taken.insert(new.path.clone())),
                    );
                }
                Err(message) => warn(&reference, &prim.path, &message, diagnostics),
            }
        }
    }
    insert(raw, grafts)
}

fn warn(reference: &MaterialxReference, prim: &str, message: &str, diagnostics: &Diagnostics) {
    let file = reference.file.display();
    diagnostics.warn(
        "unsupported-materialx",
        prim,
        format!("{file}: {message}; its materials are missing from the stage"),
    );
}

fn read(reference: &MaterialxReference, prim: &str, diagnostics: &Diagnostics) -> Option<String> {
    let size = std::fs::metadata(&reference.file).map(|metadata| metadata.len());
    let text = match size {
        Ok(size) if size > LARGEST_DOCUMENT => {
            Err(format!("{size} bytes are more than {LARGEST_DOCUMENT}"))
        }
        _ => package::read(&reference.file)
            .map_err(|error| error.to_string())
            .and_then(|bytes| String::from_utf8(bytes).map_err(|error| error.to_string())),
    };
    text.map_err(|message| warn(reference, prim, &message, diagnostics))
        .ok()
}

/// What `reference` adds below `prim`, parents first; a reference to a single material makes `prim` that material.
fn added(
    text: &str,
    reference: &MaterialxReference,
    prim: &mut RawPrim,
) -> Result<Vec<RawPrim>, String> {
    let document = Document::parse(text, &reference.file)?;
    let names: Vec<&str> = reference
        .target
        .split('/')
        .filter(|name| !name.is_empty())
        .collect();
    match names[..] {
        // without a target: the document's default prim, which USD's plug-in calls `MaterialX`
        [] | ["MaterialX"] => {
            let scope = format!("{}/Materials", prim.path);
            let mut prims = vec![RawPrim::typed(&scope, "", None)];
            prims.extend(document.materials(&scope));
            Ok(prims)
        }
        ["MaterialX", "Materials"] => Ok(document.materials(&prim.path)),
        ["MaterialX", "Materials", name] => {
            let mut prims = document
                .material(name, &prim.path)
                .ok_or_else(|| format!("it has no material `{name}`"))?;
            let material = prims.remove(0);
            prim.type_name.clone_from(&material.type_name);
            for attribute in material.attributes.shared() {
                if !prim.attributes.contains_key(&attribute.name) {
                    prim.attributes.insert_shared(Arc::clone(attribute));
                }
            }
            Ok(prims)
        }
        _ => Err(format!("<{}> is none of its materials", reference.target)),
    }
}

/// Put `grafts[i]` below prim `i`, behind it in the order of the stage.
fn insert(raw: RawStage, grafts: Vec<Vec<RawPrim>>) -> RawStage {
    let mut moved_to = Vec::with_capacity(raw.prims.len());
    let mut next = 0;
    for graft in &grafts {
        moved_to.push(next);
        next += 1 + graft.len();
    }
    let start = moved_to.get(raw.prototype_start).copied().unwrap_or(next);
    let mut prims: Vec<RawPrim> = Vec::with_capacity(next);
    for (mut prim, graft) in raw.prims.into_iter().zip(grafts) {
        let parent = prim.parent.map(|parent| moved_to[parent]);
        let prototype = prim.prototype.map(|prototype| moved_to[prototype]);
        // what many prims have in common stays so where nothing was put before them
        if (parent, prototype) != (prim.parent, prim.prototype) {
            (prim.parent, prim.prototype) = (parent, prototype);
        }
        let first = prims.len();
        prims.push(prim);
        let mut by_path = HashMap::from([(prims[first].path.clone(), first)]);
        for mut new in graft {
            let parent = new.path.rsplit_once('/').map_or("", |(parent, _)| parent);
            new.parent = Some(by_path.get(parent).copied().unwrap_or(first));
            by_path.insert(new.path.clone(), prims.len());
            prims.push(new);
        }
    }
    RawStage {
        meta: raw.meta,
        prims,
        prototype_start: start,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn referring(path: &str, file: &Path, target: &str, parent: Option<usize>) -> RawPrim {
        let mut prim = RawPrim::typed(path, "", parent);
        prim.materialx = vec![MaterialxReference {
            file: file.to_owned(),
            target: target.to_owned(),
        }];
        prim
    }

    fn plain(path: &str, parent: Option<usize>) -> RawPrim {
        RawPrim::typed(path, "", parent)
    }

    #[test]
    fn materials_stand_below_the_prim_that_references_them_and_all_indices_follow() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("look.mtlx");
        let text = r#"<materialx version="1.38">
            <standard_surface name="S" type="surfaceshader"/>
            <surfacematerial name="M" type="material">
              <input name="surfaceshader" type="surfaceshader" nodename="S"/>
            </surfacematerial></materialx>"#;
        std::fs::write(&file, text).unwrap();
        let mut instance = plain("/i", None);
        instance.prototype = Some(3);
        let raw = RawStage {
            prims: vec![
                referring("/looks", &file, "/MaterialX/Materials", None),
                instance,
                referring("/one", &file, "/MaterialX/Materials/M", None),
                plain("/__Prototype_1", None),
                plain("/__Prototype_1/m", Some(3)),
                referring("/__Prototype_1/all", &file, "", Some(3)),
                referring(
                    "/__Prototype_1/gone",
                    &file,
                    "/MaterialX/Materials/X",
                    Some(3),
                ),
            ],
            prototype_start: 3,
            ..RawStage::default()
        };
        let diagnostics = Diagnostics::default();
        let made = graft(raw, &diagnostics);
        let paths: Vec<_> = made.prims.iter().map(|prim| prim.path.as_str()).collect();
        assert_eq!(
            paths,
            [
                "/looks",
                "/looks/M",
                "/looks/M/S",
                "/i",
                "/one",
                "/one/S",
                "/__Prototype_1",
                "/__Prototype_1/m",
                "/__Prototype_1/all",
                "/__Prototype_1/all/Materials",
                "/__Prototype_1/all/Materials/M",
                "/__Prototype_1/all/Materials/M/S",
                "/__Prototype_1/gone"
            ]
        );
        assert_eq!(made.prototype_start, 6);
        assert_eq!(made.prims[3].prototype, Some(6));
        let parents: Vec<_> = made.prims.iter().map(|prim| prim.parent).collect();
        let below_prototype = [None, Some(6), Some(6), Some(8), Some(9), Some(10), Some(6)];
        assert_eq!(parents[..6], [None, Some(0), Some(1), None, None, Some(4)]);
        assert_eq!(parents[6..], below_prototype);
        assert_eq!(made.prims[4].type_name, "Material");
        let warnings = diagnostics.warnings();
        assert_eq!(warnings.len(), 1);
        assert_eq!(warnings[0].prim, "/__Prototype_1/gone");
        assert!(warnings[0].message.contains("no material `X`"));
    }

    #[test]
    fn documents_that_are_missing_or_no_xml_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let broken = folder.path().join("broken.mtlx");
        std::fs::write(&broken, "<materialx><a></materialx>").unwrap();
        let missing = folder.path().join("missing.mtlx");
        let raw = RawStage {
            prims: vec![
                referring("/a", &broken, "", None),
                referring("/b", &missing, "", None),
            ],
            prototype_start: 2,
            ..RawStage::default()
        };
        let diagnostics = Diagnostics::default();
        assert_eq!(graft(raw, &diagnostics).prims.len(), 2);
        let kinds: Vec<_> = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
        assert_eq!(kinds, ["unsupported-materialx"; 2]);
    }
}
