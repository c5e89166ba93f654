//! Checks that the modules of `cli` import each other without cycles.
//!
//! A module is a file. It depends on the modules that define the names that it uses. Re-exports are resolved, so a `mod.rs` that
//! only lists its files causes no cycle. Test-only modules are left out.

use super::crates::root;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use syn::visit::{Visit, visit_item_mod, visit_path};
use syn::{Attribute, Item, ItemMod, ItemUse, Meta, UseTree, Visibility};

/// Path of a module from the crate's root. The root has an empty path.
type Module = Vec<String>;

/// References of a file to other modules.
#[derive(Default)]
struct FileReferences {
    children: BTreeSet<String>,
    /// Names that `use` imports, with their paths.
    imports: BTreeMap<String, Vec<String>>,
    /// Paths with more than one segment, as written.
    paths: BTreeSet<Vec<String>>,
    /// Number of child modules with their body in the same file.
    inline: usize,
}

/// Modules of a crate, each with its file.
#[derive(Default)]
struct Crate(BTreeMap<Module, FileReferences>);

fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string() == "test",
        Meta::Path(path) => path.is_ident("test"),
        Meta::NameValue(_) => false,
    })
}

impl FileReferences {
    fn parse(text: &str, name: &str) -> Self {
        let file = syn::parse_file(text).unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut source = Self::default();
        source.visit_file(&file);
        source
    }

    fn import(&mut self, tree: &UseTree, mut path: Vec<String>, is_public: bool) {
        match tree {
            UseTree::Path(part) => {
                path.push(part.ident.to_string());
                self.import(&part.tree, path, is_public);
            }
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.import(tree, path.clone(), is_public)),
            UseTree::Glob(_) => panic!("a glob import hides what is used: {path:?}"),
            UseTree::Name(_) | UseTree::Rename(_) => {
                let (own, alias) = match tree {
                    UseTree::Name(name) => (&name.ident, &name.ident),
                    UseTree::Rename(rename) => (&rename.ident, &rename.rename),
                    _ => unreachable!("the other arms"),
                };
                // `use a::b::{self}` imports `b`.
                let (own, alias) = (own.to_string(), alias.to_string());
                let alias = if alias == "self" { path.last().cloned().unwrap_or_default() } else { alias };
                path.extend(Some(own).filter(|own| own != "self"));
                // A re-export is not a use by the file itself.
                if !is_public {
                    self.paths.insert(path.clone());
                }
                self.imports.insert(alias, path);
            }
        }
    }
}

impl<'ast> Visit<'ast> for FileReferences {
    fn visit_item(&mut self, item: &'ast Item) {
        let attributes = match item {
            Item::Mod(it) => &it.attrs,
            Item::Fn(it) => &it.attrs,
            Item::Use(it) => &it.attrs,
            Item::Impl(it) => &it.attrs,
            _ => return syn::visit::visit_item(self, item),
        };
        if !is_for_tests(attributes) {
            syn::visit::visit_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        self.children.insert(module.ident.to_string());
        self.inline += usize::from(module.content.is_some());
        visit_item_mod(self, module);
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        self.import(&item.tree, Vec::new(), !matches!(item.vis, Visibility::Inherited));
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.leading_colon.is_none() && path.segments.len() > 1 {
            self.paths.insert(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        }
        visit_path(self, path);
    }
}

impl Crate {
    fn read(folder: &Path) -> Self {
        fn add(all: &mut Crate, file: &Path, folder: &Path, module: Module) {
            let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            let source = FileReferences::parse(&text, &file.display().to_string());
            assert_eq!(source.inline, 0, "{}: a module within a file is none of its own", file.display());
            for child in &source.children {
                let path = [folder.join(format!("{child}.rs")), folder.join(child).join("mod.rs")];
                let file = path.iter().find(|path| path.exists()).unwrap_or_else(|| panic!("{path:?}: neither"));
                add(all, file, &folder.join(child), [&module[..], std::slice::from_ref(child)].concat());
            }
            all.0.insert(module, source);
        }
        let mut all = Self::default();
        add(&mut all, &folder.join("main.rs"), folder, Module::new());
        all
    }

    /// Returns the module that defines the item of `path` within `module`; `None`: another crate defines it, or the path is only a
    /// module.
    fn defining_module(&self, module: &Module, path: &[String], depth: usize) -> Option<Module> {
        assert!(depth < 16, "{module:?} {path:?}: names that stand for each other");
        let (first, rest) = path.split_first()?;
        let (mut at, rest) = match first.as_str() {
            "crate" => (Module::new(), rest),
            "self" => (module.clone(), rest),
            "super" => {
                let ups = path.iter().take_while(|part| *part == "super").count();
                (module[..module.len() - ups].to_vec(), &path[ups..])
            }
            name if self.0[module].children.contains(name) => (module.clone(), path),
            name => {
                let import = self.0[module].imports.get(name)?;
                return self.defining_module(module, &[import, rest].concat(), depth + 1);
            }
        };
        let mut rest = rest;
        while let Some((next, behind)) = rest.split_first().filter(|(next, _)| self.0[&at].children.contains(*next)) {
            at.push(next.clone());
            rest = behind;
        }
        // A path to a module alone only names its items.
        let name = rest.first()?;
        match self.0[&at].imports.get(name) {
            Some(import) => self.defining_module(&at, &[import, &rest[1..]].concat(), depth + 1),
            None => Some(at),
        }
    }

    /// Returns each module with the modules that it uses.
    fn edges(&self) -> BTreeMap<Module, BTreeSet<Module>> {
        let uses = |(module, source): (&Module, &FileReferences)| {
            let found = source.paths.iter().filter_map(|path| self.defining_module(module, path, 0));
            (module.clone(), found.filter(|used| used != module).collect())
        };
        self.0.iter().map(uses).collect()
    }
}

/// Finds cycles: the sets of modules that reach each other.
fn find_cycles<M: Clone + Ord>(edges: &BTreeMap<M, BTreeSet<M>>) -> BTreeSet<BTreeSet<M>> {
    let reached = |from: &M| {
        let (mut reached, mut todo) = (BTreeSet::new(), vec![from]);
        while let Some(at) = todo.pop() {
            let next = edges.get(at).into_iter().flatten();
            todo.extend(next.filter(|next| reached.insert((*next).clone())));
        }
        reached
    };
    let all: BTreeMap<M, BTreeSet<M>> = edges.keys().map(|module| (module.clone(), reached(module))).collect();
    let circle = |module: &M| all[module].iter().filter(|it| all[*it].contains(module)).cloned().collect();
    all.keys().filter(|module| all[*module].contains(*module)).map(circle).collect()
}

/// Returns the dependencies between top-level modules, each with all of its submodules.
fn top_level_edges(edges: &BTreeMap<Module, BTreeSet<Module>>) -> BTreeMap<String, BTreeSet<String>> {
    let mut tops: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let top = |module: &Module| module.first().cloned().unwrap_or_else(|| "main".to_owned());
    for (module, used) in edges {
        let own = top(module);
        let others = used.iter().map(top).filter(|other| *other != own);
        tops.entry(own.clone()).or_default().extend(others);
    }
    tops
}

#[test]
fn the_command_line_has_no_circle_of_imports() {
    let all = Crate::read(&root().join("cli/src"));
    let edges = all.edges();
    assert!(edges.len() > 80 && edges.values().map(BTreeSet::len).sum::<usize>() > 300, "the whole crate is read");
    assert_eq!(find_cycles(&edges), BTreeSet::new(), "files that use each other");
    assert_eq!(find_cycles(&top_level_edges(&edges)), BTreeSet::new(), "modules at the root that use each other");
}

#[test]
fn cycles_are_found_through_names_and_re_exports_not_in_tests() {
    let module = |path: &str| path.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect::<Module>();
    let invented = |texts: &[(&str, &str)]| {
        let sources = texts.iter().map(|(path, text)| (module(path), FileReferences::parse(text, path)));
        find_cycles(&Crate(sources.collect()).edges())
    };
    let list = "mod a; mod b; pub use b::Thing;";
    let list =
        |rest: &'static str| [("", "mod list;"), ("list", list), ("list::b", "pub struct Thing;"), ("list::a", rest)];
    assert_eq!(invented(&list("use super::Thing; fn f(_: Thing) {}")), BTreeSet::new());
    let circle = |names: &[&str]| BTreeSet::from([names.iter().map(|name| module(name)).collect::<BTreeSet<_>>()]);
    let texts = [
        ("", "mod a; mod b; mod c;"),
        ("a", "use crate::b; pub fn f() { b::g(); }"),
        ("b", "pub use crate::c::g;"),
        ("c", "pub fn g() -> u8 { let x: crate::a::X = 1; x }"),
    ];
    assert_eq!(invented(&texts), circle(&["a", "c"]), "through a re-export, which is no part of it");
    let texts = [
        ("", "mod a; mod b;"),
        ("a", "use crate::b::g; pub fn f() { g() }"),
        ("b", "pub fn g() {} #[cfg(test)] mod tests { use crate::a::f; }"),
    ];
    assert_eq!(invented(&texts), BTreeSet::new());
    let texts =
        [("", "mod a;"), ("a", "mod b; pub struct X; fn f() { b::g(); }"), ("a::b", "pub fn g(_: super::X) {}")];
    assert_eq!(invented(&texts), circle(&["a", "a::b"]), "a file and what it lists");
}
