//! A MaterialX document (specification 1.38 and 1.39) → prims as USD's plug-in makes them: a material with its surface
//! shader, and the node graphs and nodes that feed it, below.

use crate::files::package;
use crate::stage::raw::{Declaration, RawAttribute, RawPrim, Value};
use glam::{DVec2, DVec3, DVec4};
use roxmltree::Node;
use std::collections::BTreeSet;
use std::path::Path;

/// Elements that are not nodes though they stand beside them.
const NOT_NODES: [&str; 9] = [
    "input",
    "output",
    "nodegraph",
    "nodedef",
    "look",
    "collection",
    "materialassign",
    "typedef",
    "implementation",
];

/// A parsed document.
pub(super) struct Document<'a> {
    xml: roxmltree::Document<'a>,
    /// Relative file names start beside it.
    file: &'a Path,
}

impl<'a> Document<'a> {
    /// The document `text` of the file `file`.
    ///
    /// # Errors
    /// When it is no well-formed XML or its root is no `materialx` element.
    pub(super) fn parse(text: &'a str, file: &'a Path) -> Result<Self, String> {
        let xml = roxmltree::Document::parse(text).map_err(|error| error.to_string())?;
        if !xml.root_element().has_tag_name("materialx") {
            return Err("it is no MaterialX document".to_owned());
        }
        Ok(Self { xml, file })
    }

    /// All materials below `scope`.
    pub(super) fn materials(&self, scope: &str) -> Vec<RawPrim> {
        let root = self.xml.root_element();
        let names = root
            .children()
            .filter(|node| is_material(*node))
            .filter_map(name);
        names
            .filter_map(|name| self.material(name, &format!("{scope}/{name}")))
            .flatten()
            .collect()
    }

    /// Material `wanted`, as the prim `path` and those below it, parents first.
    pub(super) fn material(&self, wanted: &str, path: &str) -> Option<Vec<RawPrim>> {
        let root = self.xml.root_element();
        let mut materials = root.children().filter(|node| is_material(*node));
        let material = materials.find(|node| name(*node) == Some(wanted))?;
        let mut network = Network {
            document: self,
            path,
            prims: vec![RawPrim::typed(path, "Material", None)],
            needed: Vec::new(),
            met: BTreeSet::new(),
        };
        let surface = inputs(material).find(|input| name(*input) == Some("surfaceshader"));
        if let Some(source) = surface.and_then(|surface| network.source(surface, None)) {
            let output = connected(source);
            network.prims[0]
                .attributes
                .insert("outputs:mtlx:surface".to_owned(), output);
        }
        network.emit();
        Some(network.prims)
    }
}

/// The prims of one material, gathered from its surface shader backwards.
struct Network<'d, 'a> {
    document: &'d Document<'a>,
    path: &'d str,
    prims: Vec<RawPrim>,
    /// Top-level elements still to be emitted.
    needed: Vec<Node<'d, 'd>>,
    met: BTreeSet<String>,
}

impl<'d> Network<'d, '_> {
    fn emit(&mut self) {
        while let Some(element) = self.needed.pop() {
            let Some(own) = name(element) else { continue };
            let path = format!("{}/{own}", self.path);
            if element.has_tag_name("nodegraph") {
                self.graph(element, &path);
            } else {
                let shader = self.shader(element, &path, None);
                self.prims.push(shader);
            }
        }
    }

    fn graph(&mut self, graph: Node<'d, 'd>, path: &str) {
        let mut prim = RawPrim::typed(path, "NodeGraph", None);
        self.add_inputs(graph, &mut prim, None);
        for output in graph
            .children()
            .filter(|child| child.has_tag_name("output"))
        {
            if let (Some(own), Some(source)) = (name(output), self.source(output, Some(path))) {
                prim.attributes
                    .insert(format!("outputs:{own}"), connected(source));
            }
        }
        self.prims.push(prim);
        let nodes = graph.children().filter(|child| child.is_element());
        for node in nodes.filter(|node| !NOT_NODES.contains(&node.tag_name().name())) {
            if let Some(own) = name(node) {
                let shader = self.shader(node, &format!("{path}/{own}"), Some(path));
                self.prims.push(shader);
            }
        }
    }

    /// A node as a Shader; `graph` is the path of the graph it is in.
    fn shader(&mut self, node: Node<'d, 'd>, path: &str, graph: Option<&str>) -> RawPrim {
        let mut prim = RawPrim::typed(path, "Shader", None);
        let kind = node.attribute("type").unwrap_or("");
        let id = format!("ND_{}_{kind}", node.tag_name().name());
        prim.attributes
            .insert("info:id".to_owned(), valued("token", Value::Token(id)));
        self.add_inputs(node, &mut prim, graph);
        prim
    }

    fn add_inputs(&mut self, of: Node<'d, 'd>, prim: &mut RawPrim, graph: Option<&str>) {
        for input in inputs(of) {
            let Some(own) = name(input) else { continue };
            let attribute = match self.source(input, graph) {
                Some(source) => connected(source),
                None => match self.value(input, of) {
                    Some(attribute) => attribute,
                    None => continue,
                },
            };
            prim.attributes.insert(format!("inputs:{own}"), attribute);
        }
    }

    /// The property that feeds an input or output, if it is not a value.
    fn source(&mut self, port: Node<'d, 'd>, graph: Option<&str>) -> Option<String> {
        if let (Some(interface), Some(graph)) = (port.attribute("interfacename"), graph) {
            return Some(format!("{graph}.inputs:{interface}"));
        }
        let output = port.attribute("output").unwrap_or("out");
        if let (Some(node), Some(graph)) = (port.attribute("nodename"), graph) {
            return Some(format!("{graph}/{node}.outputs:{output}"));
        }
        let owner = port
            .attribute("nodegraph")
            .or_else(|| port.attribute("nodename"))?;
        let root = self.document.xml_root();
        let element = root
            .children()
            .find(|child| child.is_element() && name(*child) == Some(owner))?;
        // A graph's only output need not be named.
        let first = element
            .children()
            .find(|child| child.has_tag_name("output"))
            .and_then(name);
        let output = match (port.attribute("output"), first) {
            (None, Some(first)) if element.has_tag_name("nodegraph") => first,
            _ => output,
        };
        if self.met.insert(owner.to_owned()) {
            self.needed.push(element);
        }
        Some(format!("{}/{owner}.outputs:{output}", self.path))
    }

    fn value(&self, input: Node<'_, '_>, node: Node<'_, '_>) -> Option<RawAttribute> {
        let kind = input.attribute("type").unwrap_or("");
        let text = input.attribute("value")?;
        let space = inherited(input, "colorspace");
        let mut attribute = valued(kind, Value::Bool(false));
        attribute.value = Some(match kind {
            "filename" => {
                let is_color = node
                    .attribute("type")
                    .is_some_and(|kind| kind.starts_with("color"));
                let own = input.attribute("colorspace");
                let data = Some("raw");
                attribute.color_space = own
                    .or(if is_color { space } else { data })
                    .map(str::to_owned);
                self.file(input, text)
            }
            "string" => Value::Token(text.to_owned()),
            "boolean" => Value::Bool(text.trim() == "true"),
            "integer" => Value::Int(text.trim().parse().ok()?),
            _ => numeric(text, kind.starts_with("color") && is_srgb(space))?,
        });
        Some(attribute)
    }

    fn file(&self, input: Node<'_, '_>, text: &str) -> Value {
        let prefix = inherited(input, "fileprefix").unwrap_or("");
        let authored = format!("{prefix}{text}").replace("<udim>", "<UDIM>");
        let file = package::beside(self.document.file, &authored);
        let resolved = file.to_string_lossy().into_owned();
        Value::Asset { authored, resolved }
    }
}

impl Document<'_> {
    fn xml_root(&self) -> Node<'_, '_> {
        self.xml.root_element()
    }
}

fn name<'a>(node: Node<'a, '_>) -> Option<&'a str> {
    node.attribute("name")
}

fn is_material(node: Node<'_, '_>) -> bool {
    node.has_tag_name("surfacematerial")
}

fn inputs<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(|child| child.has_tag_name("input"))
}

/// Attribute `name` of `node` or the nearest element around it.
fn inherited<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    node.ancestors().find_map(|element| element.attribute(name))
}

fn is_srgb(space: Option<&str>) -> bool {
    matches!(space, Some("srgb_texture" | "srgb_rec709_scene"))
}

/// Numbers separated by commas or blanks; `None` unless there are 1 to 4, all finite.
fn numeric(text: &str, is_encoded: bool) -> Option<Value> {
    let parts = text.split([',', ' ']).filter(|part| !part.is_empty());
    let mut numbers: Vec<f64> = parts.map(|part| part.parse().ok()).collect::<Option<_>>()?;
    if is_encoded {
        // alpha is not encoded
        numbers
            .iter_mut()
            .take(3)
            .for_each(|number| *number = decoded(*number));
    }
    if numbers.iter().any(|number| !number.is_finite()) {
        return None;
    }
    match numbers[..] {
        [x] => Some(Value::Float(x)),
        [x, y] => Some(Value::Vec2(DVec2::new(x, y))),
        [x, y, z] => Some(Value::Vec3(DVec3::new(x, y, z))),
        [x, y, z, w] => Some(Value::Vec4(DVec4::new(x, y, z, w))),
        _ => None,
    }
}

/// sRGB to linear, IEC 61966-2-1.
fn decoded(x: f64) -> f64 {
    if x <= 0.04045 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    }
}

fn valued(type_name: &str, value: Value) -> RawAttribute {
    let declaration = Declaration {
        type_name: type_name.to_owned(),
        ..Declaration::default()
    };
    RawAttribute::new(declaration, Some(value))
}

fn connected(source: String) -> RawAttribute {
    let declaration = Declaration {
        connections: vec![source],
        ..Declaration::default()
    };
    RawAttribute::new(declaration, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn material(body: &str) -> Vec<RawPrim> {
        let surface = r#"<surfacematerial name="M" type="material">
            <input name="surfaceshader" type="surfaceshader" nodename="S"/></surfacematerial>"#;
        let text = format!(
            r#"<materialx version="1.38" colorspace="lin_rec709" fileprefix="tex/">{body}{surface}</materialx>"#
        );
        let document = Document::parse(&text, Path::new("/a/look.mtlx")).unwrap();
        document.materials("/L")
    }

    fn attribute<'a>(prims: &'a [RawPrim], path: &str, name: &str) -> &'a RawAttribute {
        let prim = prims.iter().find(|prim| prim.path == path).unwrap();
        &prim.attributes[name]
    }

    #[test]
    fn graphs_interfaces_and_top_level_nodes_are_connected_as_usd_writes_them() {
        let prims = material(
            r#"<nodegraph name="G">
              <input name="tint" type="color3" value="0.5, 0.25, 1" colorspace="srgb_texture"/>
              <image name="i" type="color3">
                <input name="file" type="filename" value="a.&lt;udim&gt;.png" colorspace="srgb_texture"/>
              </image>
              <multiply name="m" type="color3">
                <input name="in1" type="color3" nodename="i"/>
                <input name="in2" type="color3" interfacename="tint"/>
              </multiply>
              <output name="o" type="color3" nodename="m"/>
            </nodegraph>
            <image name="r" type="float"><input name="file" type="filename" value="r.png"/></image>
            <standard_surface name="S" type="surfaceshader">
              <input name="base_color" type="color3" nodegraph="G"/>
              <input name="specular_roughness" type="float" nodename="r"/>
              <input name="metalness" type="float" value="1"/>
              <input name="emission_color" type="color3" value="1 0 nonsense"/>
            </standard_surface>"#,
        );
        let of = |path: &str, name: &str| attribute(&prims, path, name);
        let connection = |path: &str, name: &str| of(path, name).connections[0].clone();
        assert_eq!(
            connection("/L/M", "outputs:mtlx:surface"),
            "/L/M/S.outputs:out"
        );
        assert_eq!(
            connection("/L/M/S", "inputs:base_color"),
            "/L/M/G.outputs:o"
        );
        assert_eq!(connection("/L/M/G", "outputs:o"), "/L/M/G/m.outputs:out");
        assert_eq!(connection("/L/M/G/m", "inputs:in2"), "/L/M/G.inputs:tint");
        assert_eq!(
            connection("/L/M/S", "inputs:specular_roughness"),
            "/L/M/r.outputs:out"
        );
        assert_eq!(
            of("/L/M/S", "inputs:metalness").value,
            Some(Value::Float(1.0))
        );
        let id = Value::Token("ND_standard_surface_surfaceshader".to_owned());
        assert_eq!(of("/L/M/S", "info:id").value, Some(id));
        let color = of("/L/M/G/i", "inputs:file");
        let resolved = "/a/tex/a.<UDIM>.png".to_owned();
        let authored = "tex/a.<UDIM>.png".to_owned();
        assert_eq!(color.value, Some(Value::Asset { authored, resolved }));
        assert_eq!(color.color_space.as_deref(), Some("srgb_texture"));
        // Numbers are data whatever the document's color space.
        assert_eq!(
            of("/L/M/r", "inputs:file").color_space.as_deref(),
            Some("raw")
        );
        // By IEC 61966-2-1: ((0.5 + 0.055) / 1.055)^2.4 = 0.214041.
        let Some(Value::Vec3(tint)) = of("/L/M/G", "inputs:tint").value else {
            panic!("a color");
        };
        assert!((tint.x - 0.214_041).abs() < 1e-6 && tint.z == 1.0);
        let shader = prims.iter().find(|prim| prim.path == "/L/M/S").unwrap();
        assert!(!shader.attributes.contains_key("inputs:emission_color"));
    }

    #[test]
    fn a_shader_that_feeds_itself_and_one_that_is_missing_end() {
        let prims = material(
            r#"<standard_surface name="S" type="surfaceshader">
              <input name="base_color" type="color3" nodename="S"/>
              <input name="opacity" type="color3" nodename="gone"/>
            </standard_surface>"#,
        );
        assert_eq!(prims.len(), 2);
        assert_eq!(prims[1].attributes.len(), 2);
    }
}
