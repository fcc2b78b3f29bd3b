//! Asset paths → files, as Pixar's default resolver finds them, and files → layers the crate can be trusted with:
//! text repaired ([`text`]), binary checked ([`crate_check`]), package entries read in place ([`package`]).

use super::arc_cycles::{self, Arcs};
use super::class_cycles::ClassArcs;
use super::layer_assets::Content;
use super::long_arrays::LongArrays;
use super::pulse::Pulse;
use super::{crate_check, text};
use crate::files::package::Package;
use openusd::ar::{self, Asset, ResolvedPath, Resolver};
use openusd::sdf::{AbstractData, FieldKey};
use openusd::usdc::{CrateData, CrateWriter};
use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::io::{self, Cursor};
use std::path::{Component, Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

/// Directories to look in, colon separated, the variable Pixar's default resolver reads.
const SEARCH_PATH_VARIABLE: &str = "PXR_AR_DEFAULT_SEARCH_PATH";

/// The placeholder of a tiled texture, standing for four digits.
const UDIM: &str = "<UDIM>";

/// First bytes of a binary layer.
pub(super) const CRATE_MAGIC: &[u8] = b"PXR-USDC";

/// What a text layer with inherits or specializes has somewhere.
const CLASS_WORDS: [&str; 2] = ["inherits", "specializes"];

/// Finds and reads files. Remembers what exists: a stage asks for the same file for every prim that uses it.
pub(super) struct LayerFiles {
    search: Vec<PathBuf>,
    existing: RefCell<HashMap<PathBuf, bool>>,
    packages: RefCell<HashMap<PathBuf, Option<Rc<Package>>>>,
    udims: RefCell<HashMap<String, bool>>,
    classes: RefCell<ClassArcs>,
    relocates: RefCell<Relocates>,
    last: RefCell<Option<(PathBuf, Option<Opened>)>>,
    /// See [`Self::expect_variables_of`].
    variables_of: RefCell<Option<String>>,
    /// All layers opened so far.
    opened: RefCell<HashSet<String>>,
    long_arrays: LongArrays,
    pulse: Arc<Pulse>,
}

/// Until a layer with relocates comes, layers are only noted: their arcs count from then on.
#[derive(Default)]
struct Relocates {
    noted: Vec<String>,
    known: Option<Arcs>,
}

/// Identifier of the session layer of a stage that has none of its own: no file has such a name.
pub(super) const EMPTY_SESSION: &str = "/surflux:session.usda";

const EMPTY_LAYER: &str = "#usda 1.0\n";

/// A binary layer longer than this, bytes, is not held here once it is checked: the crate makes itself a copy, which
/// stays as long as the stage.
const LARGE: usize = 8 << 20;

/// What is known of the layer opened last.
#[derive(Clone)]
struct Opened {
    content: Content,
    /// It may hold expression variables.
    has_variables: bool,
}

/// [`LayerFiles`] as the resolver the crate's stage owns.
pub(super) struct SharedFiles(pub(super) Rc<LayerFiles>);

impl LayerFiles {
    /// Layers are told to `pulse` as they are opened.
    pub(super) fn new(pulse: Arc<Pulse>) -> Self {
        let working = std::env::current_dir().into_iter();
        let listed = std::env::var_os(SEARCH_PATH_VARIABLE).unwrap_or_default();
        Self {
            search: working.chain(std::env::split_paths(&listed)).collect(),
            existing: RefCell::default(),
            packages: RefCell::default(),
            udims: RefCell::default(),
            classes: RefCell::default(),
            relocates: RefCell::default(),
            last: RefCell::default(),
            variables_of: RefCell::default(),
            opened: RefCell::default(),
            long_arrays: LongArrays::default(),
            pulse,
        }
    }

    /// What the crate has marks for.
    pub(super) fn long_arrays(&self) -> &LongArrays {
        &self.long_arrays
    }

    /// What hears of progress.
    pub(super) fn pulse(&self) -> &Pulse {
        &self.pulse
    }

    /// The layer whose bytes were asked for last.
    pub(super) fn last_opened(&self) -> Option<PathBuf> {
        self.last.borrow().as_ref().map(|(path, _)| path.clone())
    }

    /// Absolute path of the asset `authored` in the layer `identifier`; empty if there is no such file. A path with
    /// `<UDIM>` keeps it and counts as found if one tile exists.
    pub(super) fn resolve_value(&self, authored: &str, identifier: &str) -> String {
        if authored.is_empty() {
            return String::new();
        }
        let anchor = self.real_path(identifier);
        let path = self.anchored(authored, Some(&anchor));
        let found = match path.contains(UDIM) {
            true => self.has_tile(&path),
            false => self.exists(&path),
        };
        if found { path } else { String::new() }
    }

    /// Where the relative paths of the layer `identifier` start: for a package, its first layer.
    fn real_path(&self, identifier: &str) -> String {
        if !is_package(identifier) {
            return identifier.to_owned();
        }
        let package = self.package(Path::new(identifier));
        match package.as_ref().and_then(|package| package.first_layer()) {
            Some(inner) => ar::join_package_relative_path(identifier, inner),
            None => identifier.to_owned(),
        }
    }

    /// Identifier of the layer that `asset` names in the layer `anchor`, or to a user.
    pub(super) fn anchored(&self, asset: &str, anchor: Option<&str>) -> String {
        if let Some((outer, inner)) = ar::split_package_relative_path_outer(asset) {
            return ar::join_package_relative_path(&self.anchored(&outer, anchor), &inner);
        }
        let path = Path::new(asset);
        if path.is_absolute() {
            return normalized(path);
        }
        match anchor {
            Some(anchor) => self.anchored_to(asset, anchor),
            None => self.searched(asset).unwrap_or_else(|| asset.to_owned()),
        }
    }

    fn anchored_to(&self, asset: &str, anchor: &str) -> String {
        if let Some((package, layer)) = ar::split_package_relative_path_inner(anchor) {
            let folder = Path::new(&layer).parent().unwrap_or(Path::new(""));
            let beside = ar::join_package_relative_path(&package, &normalized(&folder.join(asset)));
            if is_file_relative(asset) || self.exists(&beside) {
                return beside;
            }
            let at_root = ar::join_package_relative_path(&package, &normalized(Path::new(asset)));
            return if self.exists(&at_root) {
                at_root
            } else {
                beside
            };
        }
        let folder = Path::new(anchor).parent().unwrap_or(Path::new(""));
        let beside = normalized(&folder.join(asset));
        if is_file_relative(asset) || self.exists(&beside) {
            return beside;
        }
        self.searched(asset).unwrap_or(beside)
    }

    /// `asset` in the working directory or the search path.
    fn searched(&self, asset: &str) -> Option<String> {
        let candidates = self
            .search
            .iter()
            .map(|folder| normalized(&folder.join(asset)));
        let mut existing = candidates.filter(|path| match path.contains(UDIM) {
            true => self.has_tile(path),
            false => self.exists(path),
        });
        existing.next()
    }

    pub(super) fn exists(&self, path: &str) -> bool {
        if path == EMPTY_SESSION {
            return true;
        }
        if let Some((package, inner)) = ar::split_package_relative_path_outer(path) {
            let package = self.package(Path::new(&package));
            return package.is_some_and(|package| package.has(&inner));
        }
        let path = PathBuf::from(path);
        *self
            .existing
            .borrow_mut()
            .entry(path)
            .or_insert_with_key(|path| path.is_file())
    }

    fn package(&self, path: &Path) -> Option<Rc<Package>> {
        if let Some(known) = self.packages.borrow().get(path) {
            return known.clone();
        }
        let package = Package::open(path).ok().map(Rc::new);
        self.packages
            .borrow_mut()
            .insert(path.to_owned(), package.clone());
        package
    }

    /// True if a file differs from `pattern` only by four digits in place of `<UDIM>`.
    fn has_tile(&self, pattern: &str) -> bool {
        if let Some(known) = self.udims.borrow().get(pattern) {
            return *known;
        }
        let found = match ar::split_package_relative_path_outer(pattern) {
            Some((package, inner)) => {
                let package = self.package(Path::new(&package));
                package.is_some_and(|package| package.names().any(|name| is_tile(&inner, name)))
            }
            None => folder_has_tile(Path::new(pattern)),
        };
        self.udims.borrow_mut().insert(pattern.to_owned(), found);
        found
    }

    /// The stage of the root layer `root` is about to be opened, with a session layer: the crate reads the root once for
    /// its expression variables, then the session layer, then the root again. A root without such variables is as good
    /// as empty until then.
    pub(super) fn expect_variables_of(&self, root: &str) {
        *self.variables_of.borrow_mut() = Some(root.to_owned());
    }

    /// The stage is open: what was held of layers, because the crate may open them again at once, is not needed.
    pub(super) fn let_go(&self) {
        *self.variables_of.borrow_mut() = None;
        if let Some((_, opened)) = &mut *self.last.borrow_mut() {
            *opened = None;
        }
    }

    fn open(&self, path: &str) -> io::Result<Box<dyn Asset>> {
        let for_variables = self.variables_of.borrow().as_deref() == Some(path);
        if !for_variables {
            *self.variables_of.borrow_mut() = None;
        }
        if path == EMPTY_SESSION {
            return Content::of(EMPTY_LAYER.into()).asset(path);
        }
        let opened = self.opened(path)?;
        match for_variables && !opened.has_variables {
            true => Content::of(empty_layer(path)?).asset(path),
            false => opened.content.asset(path),
        }
    }

    /// The file `path`, repaired or checked if it is a layer. The crate opens a layer up to three times in a row.
    fn opened(&self, path: &str) -> io::Result<Opened> {
        if let Some((last, Some(opened))) = &*self.last.borrow()
            && last.as_os_str() == path
        {
            return Ok(opened.clone());
        }
        *self.last.borrow_mut() = Some((PathBuf::from(path), None));
        let (bytes, has_variables) = self.read(path)?;
        let is_file = ar::split_package_relative_path_outer(path).is_none();
        let content = match is_file && bytes.len() > LARGE && bytes.starts_with(CRATE_MAGIC) {
            true => {
                drop(bytes);
                let without = self.long_arrays.without(Path::new(path));
                without.map_or(Content::Large, Content::of)
            }
            false => Content::of(bytes),
        };
        let opened = Opened {
            content,
            has_variables,
        };
        *self.last.borrow_mut() = Some((PathBuf::from(path), Some(opened.clone())));
        Ok(opened)
    }

    /// Content of the file `path`, and whether it may hold expression variables.
    fn read(&self, path: &str) -> io::Result<(Vec<u8>, bool)> {
        let bytes = self.bytes(path)?;
        if self.opened.borrow_mut().insert(path.to_owned()) {
            self.pulse.layer(bytes.len());
        }
        if is_package(path) {
            return Ok((bytes, true));
        }
        if bytes.starts_with(CRATE_MAGIC) {
            let soundness = crate_check::check(&bytes).map_err(io::Error::other)?;
            if self.relocates_count(path, soundness.has_relocates) || soundness.has_classes {
                let data = CrateData::open(Cursor::new(&bytes), true).map_err(io::Error::other)?;
                self.check_arcs(path, &data)?;
            }
            return Ok((bytes, soundness.has_variables));
        }
        let text = String::from_utf8(bytes).map_err(io::Error::other)?;
        let repaired = text::repaired(&text).map_err(io::Error::other)?;
        let text = repaired.unwrap_or(text);
        let has = |words: [&str; 2]| words.iter().any(|word| text.contains(word));
        if self.relocates_count(path, has(arc_cycles::WORDS)) || has(CLASS_WORDS) {
            self.check_arcs(
                path,
                &openusd::usda::parse(&text).map_err(io::Error::other)?,
            )?;
        }
        let has_variables = text.contains(FieldKey::ExpressionVariables.as_str());
        Ok((text.into_bytes(), has_variables))
    }

    fn bytes(&self, path: &str) -> io::Result<Vec<u8>> {
        match ar::split_package_relative_path_outer(path) {
            Some((package, inner)) => Package::open(Path::new(&package))?.read(&inner),
            None => std::fs::read(path),
        }
    }

    /// True if relocates were met, in the layer `path` (`has_relocates`) or before it, so that its arcs matter.
    fn relocates_count(&self, path: &str, has_relocates: bool) -> bool {
        let mut relocates = self.relocates.borrow_mut();
        if relocates.known.is_none() && !has_relocates {
            relocates.noted.push(path.to_owned());
            return false;
        }
        if relocates.known.is_none() {
            let mut known = Arcs::default();
            for path in std::mem::take(&mut relocates.noted) {
                self.add_again(&path, &mut known);
            }
            relocates.known = Some(known);
        }
        true
    }

    /// Take in a layer that was read before relocates were met. It was sound then.
    fn add_again(&self, path: &str, known: &mut Arcs) {
        let Ok(bytes) = self.bytes(path) else {
            return;
        };
        let anchored = |asset: &str| self.stack_root(asset, path);
        if bytes.starts_with(CRATE_MAGIC) {
            if let Ok(data) = CrateData::open(Cursor::new(&bytes), true) {
                known.add(path, &data, &anchored);
            }
        } else if let Ok(Some(text)) = super::checked_layer(&bytes)
            && let Ok(data) = openusd::usda::parse(&text)
        {
            known.add(path, &data, &anchored);
        }
    }

    /// The layer that `asset` stands for in the layer `path`; of a package its first.
    fn stack_root(&self, asset: &str, path: &str) -> String {
        self.real_path(&self.anchored(asset, Some(path)))
    }

    /// Layers with inherits, specializes or relocates are parsed once more for this: they are few and small, and the
    /// crate does not survive the bad ones.
    fn check_arcs(&self, path: &str, layer: &dyn AbstractData) -> io::Result<()> {
        let relocates = &mut *self.relocates.borrow_mut();
        if let Some(known) = &mut relocates.known {
            known.add(path, layer, &|asset| self.stack_root(asset, path));
            known.check_moves().map_err(io::Error::other)?;
        }
        let mut classes = self.classes.borrow_mut();
        classes.add(layer).map_err(io::Error::other)?;
        let mut alone = Arcs::default();
        alone.add(path, layer, &|asset| self.stack_root(asset, path));
        alone.check_stack(path).map_err(io::Error::other)
    }
}

impl Resolver for SharedFiles {
    fn create_identifier(&self, asset_path: &str, anchor: Option<&ResolvedPath>) -> String {
        if asset_path.is_empty() {
            return String::new();
        }
        let anchor = anchor.map(|anchor| self.0.real_path(&anchor.to_string_lossy()));
        self.0.anchored(asset_path, anchor.as_deref())
    }

    fn resolve(&self, asset_path: &str) -> Option<ResolvedPath> {
        let found = !asset_path.is_empty() && self.0.exists(asset_path);
        found.then(|| ResolvedPath::new(asset_path))
    }

    fn resolve_for_new_asset(&self, asset_path: &str) -> Option<ResolvedPath> {
        Some(ResolvedPath::new(asset_path))
    }

    fn open_asset(&self, resolved_path: &ResolvedPath) -> io::Result<Box<dyn Asset>> {
        self.0.open(&resolved_path.to_string_lossy())
    }
}

/// A layer without content in the format that the name `path` asks for.
fn empty_layer(path: &str) -> io::Result<Vec<u8>> {
    let extension = Path::new(path).extension().unwrap_or_default();
    if !extension.eq_ignore_ascii_case("usdc") {
        return Ok(EMPTY_LAYER.into());
    }
    let mut bytes = Cursor::new(Vec::new());
    let empty = openusd::usda::parse(EMPTY_LAYER).map_err(io::Error::other)?;
    CrateWriter::write(&empty, &mut bytes).map_err(io::Error::other)?;
    Ok(bytes.into_inner())
}

fn is_package(path: &str) -> bool {
    Path::new(path)
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("usdz"))
}

fn is_file_relative(asset: &str) -> bool {
    asset.starts_with("./") || asset.starts_with("../")
}

/// `path` without `.` and `..`, forward slashes, no look at the file system: links stay as they are named.
fn normalized(path: &Path) -> String {
    let mut parts = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if parts.file_name().is_some() => {
                parts.pop();
            }
            other => parts.push(other),
        }
    }
    parts.to_string_lossy().into_owned()
}

fn folder_has_tile(pattern: &Path) -> bool {
    let (Some(folder), Some(name)) = (
        pattern.parent(),
        pattern.file_name().and_then(|n| n.to_str()),
    ) else {
        return false;
    };
    let Ok(entries) = std::fs::read_dir(folder) else {
        return false;
    };
    entries.flatten().any(|entry| {
        entry
            .file_name()
            .to_str()
            .is_some_and(|file| is_tile(name, file))
    })
}

fn is_tile(pattern: &str, name: &str) -> bool {
    let Some((before, after)) = pattern.split_once(UDIM) else {
        return false;
    };
    let tile = name
        .strip_prefix(before)
        .and_then(|rest| rest.strip_suffix(after));
    tile.is_some_and(|tile| tile.len() == 4 && tile.bytes().all(|byte| byte.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_normalized_without_the_file_system() {
        assert_eq!(normalized(Path::new("/a/./b/../c.usd")), "/a/c.usd");
        assert_eq!(normalized(Path::new("../c.usd")), "../c.usd");
    }

    #[test]
    fn a_tile_has_four_digits_in_place_of_the_placeholder() {
        assert!(is_tile("wood.<UDIM>.png", "wood.1011.png"));
        assert!(!is_tile("wood.<UDIM>.png", "wood.101.png"));
        assert!(!is_tile("wood.<UDIM>.png", "wood.10x1.png"));
        assert!(!is_tile("wood.png", "wood.png"));
    }

    #[test]
    fn relative_paths_start_at_the_layer_and_search_paths_fall_back_to_the_search_folders() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        std::fs::create_dir_all(root.join("show/shot")).unwrap();
        std::fs::create_dir_all(root.join("lib")).unwrap();
        std::fs::write(root.join("show/near.png"), "x").unwrap();
        std::fs::write(root.join("lib/far.png"), "x").unwrap();
        std::fs::write(root.join("show/t.1001.png"), "x").unwrap();
        let mut files = LayerFiles::new(Arc::default());
        files.search = vec![root.join("lib")];
        let layer = root.join("show/shot/a.usda").to_string_lossy().into_owned();
        let expect = |name: &str| root.join(name).to_string_lossy().into_owned();
        assert_eq!(
            files.resolve_value("../near.png", &layer),
            expect("show/near.png")
        );
        assert_eq!(
            files.resolve_value("far.png", &layer),
            expect("lib/far.png")
        );
        assert_eq!(files.resolve_value("./far.png", &layer), "");
        assert_eq!(
            files.resolve_value("../t.<UDIM>.png", &layer),
            expect("show/t.<UDIM>.png")
        );
        assert_eq!(files.resolve_value("../u.<UDIM>.png", &layer), "");
    }

    /// Relocates count from the layer that has them on, classes or none in it.
    #[test]
    fn circles_through_a_layer_with_relocates_and_classes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, format!("#usda 1.0\n{text}")).unwrap();
            path.to_string_lossy().into_owned()
        };
        let root = write(
            "root.usda",
            "( subLayers = [@./low.usda@]\nrelocates = { </W/d/d/a>: </W/b/c> } )\ndef \"W\" { def \"a\" ( specializes = </W/c> ) {} }",
        );
        let low = write(
            "low.usda",
            "def \"W\" { def \"d\" { def \"d\" ( references = </W/b/c> ) {} } def \"b\" ( inherits = </W/c> ) {} }",
        );
        let files = LayerFiles::new(Arc::default());
        assert!(files.read(&root).is_ok());
        let message = files.read(&low).unwrap_err().to_string();
        assert!(message.contains("relocates move </W/d/d/a>"), "{message}");
    }
}
