//! Which file imports which, as a parser reads them: groups, renames, `self`, `super`, names that
//! an import brings in, paths in the middle of code, in attributes and in macros, and through
//! re-exports. Tests are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};

/// A path as it is written from the root: of this crate begins with `crate`, of another with its
/// name.
pub type Absolute = Vec<String>;

/// The files of a crate, by the modules that they are: `store::sqlite` is `store/sqlite/mod.rs`.
pub struct Sources(BTreeMap<Vec<String>, Source>);

/// What one file names.
#[derive(Debug, Default)]
pub struct Source {
    /// What it uses.
    uses: BTreeSet<Absolute>,
    /// What it re-exports: by which name.
    exports: BTreeMap<String, Absolute>,
}

/// How often a name may lead to another.
const MOST_STEPS: usize = 8;

impl Sources {
    /// Reads all files below the folders of several crates as if they were one: what is in one of
    /// them the others know by the same path, in the room that the whole crate is, if it is one.
    pub fn read_folders(roots: &[(PathBuf, Option<&str>)]) -> Self {
        let mut files = BTreeMap::new();
        // The first last: of several roots, its map is the one.
        for (folder, room) in roots.iter().rev() {
            let room: Vec<String> = room.iter().map(|room| (*room).to_owned()).collect();
            read_folder(folder, &room, room.len(), &mut files);
        }
        Self(files)
    }

    /// Makes them of modules and texts.
    pub fn of_modules(texts: &[(&str, &str)]) -> Self {
        Self::of_crate("", texts)
    }

    /// Makes them of modules and texts of a crate that is a room.
    pub fn of_crate(room: &str, texts: &[(&str, &str)]) -> Self {
        let depth = parts(room).len();
        let file = |(module, text): &(&str, &str)| {
            let module = parts(module);
            (module.clone(), Source::parse(text, &module, depth))
        };
        Self(texts.iter().map(file).collect())
    }

    /// Returns each file with its module.
    pub fn files(&self) -> impl Iterator<Item = (String, &Source)> {
        self.0
            .iter()
            .map(|(module, source)| (module.join("::"), source))
    }

    /// Returns which files each file imports from.
    pub fn imports(&self) -> BTreeMap<String, BTreeSet<String>> {
        self.0
            .iter()
            .map(|(module, source)| (module.join("::"), self.imports_of(module, source)))
            .collect()
    }

    /// What a file re-exports of the files below it, it only shows: whoever imports it there
    /// imports them.
    fn imports_of(&self, module: &[String], source: &Source) -> BTreeSet<String> {
        let home = |path: &Absolute| self.home(path, MOST_STEPS);
        let shown = source
            .exports
            .values()
            .filter_map(home)
            .filter(|home| !home.starts_with(module));

        let homes = source.uses.iter().filter_map(home).chain(shown);
        homes
            .filter(|home| home != module)
            .map(|home| home.join("::"))
            .collect()
    }

    /// Returns the file in which that is written what a path names, if it is in this crate.
    fn home(&self, path: &[String], steps: usize) -> Option<Vec<String>> {
        let inside = path.strip_prefix(&["crate".to_owned()])?;
        let length = (0..=inside.len())
            .rev()
            .find(|length| self.0.contains_key(&inside[..*length]))?;
        let (module, item) = inside.split_at(length);
        let export = item
            .first()
            .and_then(|name| self.0[module].exports.get(name))
            .filter(|_| steps > 0);
        match export {
            Some(path) => self.home(path, steps - 1),
            None => Some(module.to_vec()),
        }
    }

    /// Returns the groups of files that import each other, directly or through others.
    pub fn circles(&self) -> BTreeSet<Vec<String>> {
        let imports = self.imports();
        let reached: BTreeMap<&String, BTreeSet<&String>> = imports
            .keys()
            .map(|from| (from, reached(from, &imports)))
            .collect();
        let circle = |(from, to): (&&String, &BTreeSet<&String>)| {
            let circle = to
                .iter()
                .filter(|other| reached.get(*other).is_some_and(|back| back.contains(from)));
            circle
                .map(|module| (*module).clone())
                .collect::<Vec<String>>()
        };
        reached
            .iter()
            .map(circle)
            .filter(|circle| circle.len() > 1)
            .collect()
    }
}

/// Returns the parts of a module's path.
fn parts(module: &str) -> Vec<String> {
    module
        .split("::")
        .filter(|part| !part.is_empty())
        .map(str::to_owned)
        .collect()
}

/// Returns what can be reached from a file.
fn reached<'a>(
    from: &'a String,
    imports: &'a BTreeMap<String, BTreeSet<String>>,
) -> BTreeSet<&'a String> {
    let mut reached = BTreeSet::new();
    let mut waiting: Vec<&String> = imports[from].iter().collect();
    while let Some(next) = waiting.pop() {
        if reached.insert(next) {
            waiting.extend(&imports[next]);
        }
    }
    reached
}

fn read_folder(
    folder: &Path,
    module: &[String],
    depth: usize,
    files: &mut BTreeMap<Vec<String>, Source>,
) {
    for entry in fs::read_dir(folder).expect("a folder can be read") {
        let path = entry.expect("an entry can be read").path();
        let name = path
            .file_stem()
            .expect("has a name")
            .to_string_lossy()
            .into_owned();
        let is_root = !path.is_dir() && ["mod", "lib"].contains(&name.as_str());
        let inside: Vec<String> = module
            .iter()
            .cloned()
            .chain((!is_root).then_some(name))
            .collect();
        if path.is_dir() {
            read_folder(&path, &inside, depth, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).expect("a source can be read");
            files.insert(inside.clone(), Source::parse(&text, &inside, depth));
        }
    }
}

impl Source {
    /// Reads the text of a module, whose crate is so deep in the one that all are read as.
    pub fn parse(text: &str, module: &[String], depth: usize) -> Self {
        let file = syn::parse_file(text)
            .unwrap_or_else(|error| panic!("{} can be parsed: {error}", module.join("::")));
        let mut reader = Reader {
            scope: Scope::new(module.to_vec(), depth, &file.items),
            is_inside: false,
            found: Self::default(),
        };
        reader.visit_file(&file);
        reader.close_scope();
        reader.found
    }

    /// Returns what it uses and what it re-exports.
    pub fn paths(&self) -> impl Iterator<Item = &Absolute> {
        self.uses.iter().chain(self.exports.values())
    }
}

/// Collects the paths of one file.
struct Reader {
    scope: Scope,
    /// Whether the scope is a module that is written out in the file.
    is_inside: bool,
    found: Source,
}

/// The paths of one module, as they are written.
#[derive(Default)]
struct Scope {
    module: Vec<String>,
    /// How many parts of its path are the room that the whole crate is.
    depth: usize,
    /// The modules that it declares, whose names begin paths.
    children: BTreeSet<String>,
    /// What its imports name, by the name that they bring in.
    names: BTreeMap<String, Vec<String>>,
    /// The names of these that others may import from here.
    exported: BTreeSet<String>,
    imported: Vec<Vec<String>>,
    /// Paths in code.
    written: Vec<Vec<String>>,
}

impl Scope {
    fn new(module: Vec<String>, depth: usize, items: &[syn::Item]) -> Self {
        let child = |item: &syn::Item| match item {
            syn::Item::Mod(item) => Some(item.ident.to_string()),
            _ => None,
        };
        Self {
            module,
            depth,
            children: items.iter().filter_map(child).collect(),
            ..Self::default()
        }
    }

    /// Returns a path as it is from the root.
    fn absolute(&self, path: &[String], steps: usize) -> Option<Absolute> {
        let above = |levels: usize| {
            let kept = self.module.len().checked_sub(levels)?;
            Some(std::iter::once("crate".to_owned()).chain(self.module[..kept].iter().cloned()))
        };
        let first = path.first()?;
        let supers = path.iter().take_while(|part| *part == "super").count();

        let (before, rest) = match first.as_str() {
            "super" => (above(supers)?.collect(), &path[supers..]),
            "self" => (above(0)?.collect(), &path[1..]),
            "crate" => (above(self.module.len() - self.depth)?.collect(), &path[1..]),
            "nudge" | "nudge_core" | "nudge_worlds" => (vec!["crate".to_owned()], &path[1..]),
            "nudge_wire" => (in_room("api"), &path[1..]),
            "nudge_client" => (in_room("client"), &path[1..]),
            child if self.children.contains(child) => (above(0)?.collect(), path),
            _ => match self
                .names
                .get(first)
                .filter(|named| steps > 0 && named.first() != Some(first))
            {
                Some(named) => return self.absolute(&[named, &path[1..]].concat(), steps - 1),
                None => (Vec::new(), path),
            },
        };
        Some([before.as_slice(), rest].concat())
    }
}

/// Returns how a path begins that is in the crate which is a room.
fn in_room(room: &str) -> Absolute {
    vec!["crate".to_owned(), room.to_owned()]
}

impl Reader {
    /// Finds out what the paths of a module lead to, once all its names are known.
    fn close_scope(&mut self) {
        let scope = std::mem::take(&mut self.scope);
        // A name alone is one of this file, unless an import brought it in.
        let is_import = |path: &&Vec<String>| path.len() > 1 || scope.names.contains_key(&path[0]);
        let uses = scope
            .written
            .iter()
            .filter(is_import)
            .chain(&scope.imported);
        self.found
            .uses
            .extend(uses.filter_map(|path| scope.absolute(path, MOST_STEPS)));

        let export = |name: &String| {
            Some((
                name.clone(),
                scope.absolute(&scope.names[name], MOST_STEPS)?,
            ))
        };
        self.found
            .exports
            .extend(scope.exported.iter().filter_map(export));
    }

    fn add(&mut self, path: Vec<String>) {
        if !path.is_empty() {
            self.scope.written.push(path);
        }
    }

    fn add_tree(&mut self, before: &[String], tree: &syn::UseTree, is_exported: bool) {
        let with = |name: &syn::Ident| [before, &[name.to_string()]].concat();
        match tree {
            syn::UseTree::Path(path) => self.add_tree(&with(&path.ident), &path.tree, is_exported),
            syn::UseTree::Group(group) => group
                .items
                .iter()
                .for_each(|tree| self.add_tree(before, tree, is_exported)),
            syn::UseTree::Glob(_) => self.scope.imported.push(before.to_vec()),
            syn::UseTree::Name(name) if name.ident == "self" => {
                self.add_name(
                    before.to_vec(),
                    before.last().cloned().unwrap_or_default(),
                    is_exported,
                );
            }
            syn::UseTree::Name(name) => {
                self.add_name(with(&name.ident), name.ident.to_string(), is_exported)
            }
            syn::UseTree::Rename(rename) if rename.ident == "self" => {
                self.add_name(before.to_vec(), rename.rename.to_string(), is_exported);
            }
            syn::UseTree::Rename(rename) => {
                self.add_name(with(&rename.ident), rename.rename.to_string(), is_exported)
            }
        }
    }

    fn add_name(&mut self, path: Vec<String>, name: String, is_exported: bool) {
        self.scope.names.insert(name.clone(), path.clone());
        if is_exported && !self.is_inside {
            self.scope.exported.insert(name);
        } else {
            self.scope.imported.push(path);
        }
    }

    /// Adds the paths in what a macro or an attribute is given, which may be of any form; a text
    /// may be a path too.
    fn add_tokens(&mut self, tokens: proc_macro2::TokenStream) {
        use proc_macro2::TokenTree;
        let (mut path, mut colons) = (Vec::new(), 0);
        for token in tokens {
            match token {
                TokenTree::Ident(ident) if colons == 2 => path.push(ident.to_string()),
                TokenTree::Ident(ident) => {
                    self.add(std::mem::replace(&mut path, vec![ident.to_string()]))
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => {
                    colons += 1;
                    continue;
                }
                TokenTree::Punct(_) => self.add(std::mem::take(&mut path)),
                TokenTree::Group(group) => {
                    self.add(std::mem::take(&mut path));
                    self.add_tokens(group.stream());
                }
                TokenTree::Literal(literal) => {
                    self.add(std::mem::take(&mut path));
                    self.add_text(&literal);
                }
            }
            colons = 0;
        }
        self.add(path);
    }

    fn add_text(&mut self, literal: &proc_macro2::Literal) {
        let text = syn::parse_str::<syn::LitStr>(&literal.to_string());
        if let Ok(path) = text.and_then(|text| text.parse::<syn::Path>()) {
            self.add(
                path.segments
                    .iter()
                    .map(|segment| segment.ident.to_string())
                    .collect(),
            );
        }
    }
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        syn::Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string() == "test",
        meta => meta.path().is_ident("test"),
    })
}

impl<'a> Visit<'a> for Reader {
    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        let Some((_, items)) = item.content.as_ref().filter(|_| !is_test(&item.attrs)) else {
            return;
        };
        let module = [self.scope.module.as_slice(), &[item.ident.to_string()]].concat();
        let inner = Scope::new(module, self.scope.depth, items);
        let outer = (std::mem::replace(&mut self.scope, inner), self.is_inside);

        self.is_inside = true;
        visit::visit_item_mod(self, item);
        self.close_scope();
        (self.scope, self.is_inside) = outer;
    }

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        if !is_test(&item.attrs) {
            let is_exported = !matches!(item.vis, syn::Visibility::Inherited);
            self.add_tree(&[], &item.tree, is_exported);
        }
    }

    fn visit_item_extern_crate(&mut self, item: &'a syn::ItemExternCrate) {
        let name = item.rename.as_ref().map_or(&item.ident, |(_, name)| name);
        self.add_name(vec![item.ident.to_string()], name.to_string(), false);
    }

    /// Who may see an item is not what it uses.
    fn visit_visibility(&mut self, _: &'a syn::Visibility) {}

    fn visit_path(&mut self, path: &'a syn::Path) {
        self.add(
            path.segments
                .iter()
                .map(|segment| segment.ident.to_string())
                .collect(),
        );
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'a syn::Macro) {
        self.add_tokens(item.tokens.clone());
        visit::visit_macro(self, item);
    }

    fn visit_meta_list(&mut self, list: &'a syn::MetaList) {
        self.add_tokens(list.tokens.clone());
        visit::visit_meta_list(self, list);
    }
}
