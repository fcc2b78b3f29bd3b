//! Instances beside each other that are alike, and those that only look it.

use super::*;

const KIT: &str = r#"
def Xform "K" ( variants = { string look = "red" }; prepend variantSets = "look" ) {
    double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 20: (20, 0, 1) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    MESH
    variantSet "look" = {
        "red" { RED }
        "blue" { BLUE }
    }
}
def Xform "Other" { OTHER }
"#;

const ROOT: &str = r#"( subLayers = [@weak.usda@] )
def Material "mat" { }
def Xform "W" {
    def "i0" ( instanceable = true; prepend references = @kit.usda@</K> ) { }
    def "i1" ( instanceable = true; prepend references = @kit.usda@</K> ) { PLACED }
    def "i2" ( instanceable = true; prepend references = @kit.usda@</K> ) {
        token purpose = "render"
    }
    def "note" ( instanceable = true; customData = { int n = 1 }; prepend references = @kit.usda@</K> ) { PLACED }
    def "bound" ( instanceable = true; apiSchemas = ["MaterialBindingAPI"]; prepend references = @kit.usda@</K> ) {
        rel material:binding = </mat>
    }
    def "bound2" ( instanceable = true; apiSchemas = ["MaterialBindingAPI"]; prepend references = @kit.usda@</K> ) { }
    def "blue" ( instanceable = true; variants = { string look = "blue" }; prepend references = @kit.usda@</K> ) { }
    def "child" ( instanceable = true; prepend references = @kit.usda@</K> ) {
        over "m" {
            token purpose = "guide"
        }
    }
    def "weak" ( instanceable = true; prepend references = @kit.usda@</K> ) { PLACED }
    def "other" ( instanceable = true; prepend references = @kit.usda@</Other> ) { PLACED }
    def "free" ( instanceable = false; prepend references = @kit.usda@</K> ) { PLACED }
    def "off" ( instanceable = true; active = false; prepend references = @kit.usda@</K> ) { }
    def "late" ( instanceable = true; prepend references = @kit.usda@</K> (offset = 10) ) { }
    def "late2" ( instanceable = true; prepend references = @kit.usda@</K> (offset = 10) ) { PLACED }
    def "paid" ( instanceable = true; payload = @kit.usda@</K> ) { }
    def "i3" ( instanceable = true; prepend references = @kit.usda@</K> ) { PLACED }
    def Xform "group" ( instanceable = true; references = </group> ) { }
    def Xform "group2" ( instanceable = true; references = </group> ) { PLACED }
}
class Xform "group" {
    def "n0" ( instanceable = true; prepend references = @kit.usda@</Other> ) { }
    def "n1" ( instanceable = true; prepend references = @kit.usda@</Other> ) { PLACED }
}
"#;

/// Meshes of each prim of [`ROOT`]'s `W`, in its order.
const DRAWN: [usize; 18] = [2, 2, 2, 2, 2, 2, 2, 2, 3, 1, 2, 0, 2, 2, 2, 2, 2, 2];

#[test]
fn instances_alike_keep_what_is_their_own() {
    let placed = "double3 xformOp:translate = (3, 4, 5)
        uniform token[] xformOpOrder = [\"xformOp:translate\"]\n";
    let root = ROOT.replace("PLACED", placed);
    let kit = [
        ("MESH", "m", 1.0),
        ("RED", "red", 2.0),
        ("BLUE", "blue", 3.0),
        ("OTHER", "o", 4.0),
    ];
    let kit = kit
        .iter()
        .fold(KIT.to_owned(), |kit, (word, name, height)| {
            kit.replace(word, &mesh(name, *height))
        });
    let weak = "over \"W\" {\n over \"weak\" ( prepend references = @kit.usda@</Other> ) { }\n}";
    let files = [
        ("root.usda", &*root),
        ("weak.usda", weak),
        ("kit.usda", &*kit),
    ];
    for time in [None, Some(7.25)] {
        equal_files(&files, time, DRAWN.iter().sum());
    }
}
