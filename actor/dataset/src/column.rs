//! Columns of a table, and the schema that follows from them: the same as pyarrow writes, so that every reader of
//! Parquet finds what it is used to.

use parquet::basic::Type;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::Result;
use parquet::file::writer::SerializedRowGroupWriter;
use std::fmt::Write as _;
use std::io::Write;

/// Values of all rows, one after the other.
#[derive(Debug, Clone)]
pub enum Values {
    /// Yes or no.
    Bool(Vec<bool>),
    /// Numbers.
    Int(Vec<i64>),
    /// 64 bits without a sign.
    Hash(Vec<i64>),
    /// Measures.
    Real(Vec<f32>),
    /// Statistics.
    Double(Vec<f64>),
    /// Bytes.
    Bytes(Vec<ByteArray>),
    /// Text.
    Text(Vec<ByteArray>),
}

/// What a row holds of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// One value.
    One,
    /// Values in lists of lists, this deep; lists within the outermost have one value each.
    Lists(usize),
    /// A picture as Hugging Face's `datasets` has it: bytes, and a path that is missing.
    Picture,
}

/// A column.
#[derive(Debug, Clone)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// What a row holds of it.
    pub shape: Shape,
    /// Its values.
    pub values: Values,
}

impl Values {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Bool(values) => values.len(),
            Self::Int(values) | Self::Hash(values) => values.len(),
            Self::Real(values) => values.len(),
            Self::Double(values) => values.len(),
            Self::Bytes(values) | Self::Text(values) => values.len(),
        }
    }

    /// About the bytes that they take.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Bytes(values) | Self::Text(values) => values.iter().map(ByteArray::len).sum(),
            _ => 8 * self.len(),
        }
    }

    /// Takes over what another column holds.
    ///
    /// # Panics
    /// If it holds something else.
    fn append(&mut self, other: Self) {
        match (self, other) {
            (Self::Bool(values), Self::Bool(more)) => values.extend(more),
            (Self::Int(values), Self::Int(more)) | (Self::Hash(values), Self::Hash(more)) => values.extend(more),
            (Self::Real(values), Self::Real(more)) => values.extend(more),
            (Self::Double(values), Self::Double(more)) => values.extend(more),
            (Self::Bytes(values), Self::Bytes(more)) | (Self::Text(values), Self::Text(more)) => values.extend(more),
            _ => panic!("a column keeps its type"),
        }
    }

    fn kind(&self) -> (Type, &'static str) {
        match self {
            Self::Bool(_) => (Type::BOOLEAN, ""),
            Self::Int(_) => (Type::INT64, ""),
            Self::Hash(_) => (Type::INT64, " (INTEGER(64,false))"),
            Self::Real(_) => (Type::FLOAT, ""),
            Self::Double(_) => (Type::DOUBLE, ""),
            Self::Bytes(_) => (Type::BYTE_ARRAY, ""),
            Self::Text(_) => (Type::BYTE_ARRAY, " (STRING)"),
        }
    }
}

impl Column {
    /// One value a row.
    pub fn new(name: &str, values: Values) -> Self {
        Self { name: name.to_owned(), shape: Shape::One, values }
    }

    /// One text a row.
    pub fn text<'a>(name: &str, texts: impl IntoIterator<Item = &'a str>) -> Self {
        Self::new(name, Values::Text(texts.into_iter().map(|text| text.as_bytes().to_vec().into()).collect()))
    }

    /// The same number in each of so many rows.
    pub fn same(name: &str, number: i64, rows: usize) -> Self {
        Self::new(name, Values::Int(vec![number; rows]))
    }

    /// Takes over the rows of another.
    ///
    /// # Panics
    /// If it is of another type.
    pub fn append(&mut self, other: Self) {
        assert_eq!((&self.name, self.shape), (&other.name, other.shape), "rows of the same columns");
        self.values.append(other.values);
    }

    /// Its part of a schema, in Parquet's language for it.
    fn schema(&self) -> String {
        let (kind, annotation) = self.values.kind();
        let name = &self.name;
        match self.shape {
            Shape::One => format!("OPTIONAL {kind} {name}{annotation};\n"),
            Shape::Picture => {
                format!("OPTIONAL GROUP {name} {{ OPTIONAL BYTE_ARRAY bytes; OPTIONAL BYTE_ARRAY path (STRING); }}\n")
            }
            Shape::Lists(depth) => {
                (0..depth).rev().fold(format!("OPTIONAL {kind} element{annotation};"), |inner, level| {
                    let name = if level == 0 { name } else { "element" };
                    format!("OPTIONAL GROUP {name} (LIST) {{ REPEATED GROUP list {{ {inner} }} }}")
                }) + "\n"
            }
        }
    }

    /// Writes it as the next column of a group of so many rows.
    fn write<W: Write + Send>(&self, group: &mut SerializedRowGroupWriter<'_, W>, rows: usize) -> Result<()> {
        // How deep a value is: each optional and each repeated node above it counts.
        let depth = match self.shape {
            Shape::One => 1,
            Shape::Picture => 2,
            Shape::Lists(depth) => 2 * depth as i16 + 1,
        };
        let there = vec![depth; self.values.len()];
        let row_length = self.values.len() / rows.max(1);
        let repeated: Option<Vec<i16>> = matches!(self.shape, Shape::Lists(_))
            .then(|| (0..self.values.len()).map(|index| i16::from(index % row_length.max(1) > 0)).collect());
        let levels = (&there[..], repeated.as_deref());
        match &self.values {
            Values::Bool(values) => leaf::<BoolType, W>(group, values, levels)?,
            Values::Int(values) | Values::Hash(values) => leaf::<Int64Type, W>(group, values, levels)?,
            Values::Real(values) => leaf::<FloatType, W>(group, values, levels)?,
            Values::Double(values) => leaf::<DoubleType, W>(group, values, levels)?,
            Values::Bytes(values) | Values::Text(values) => leaf::<ByteArrayType, W>(group, values, levels)?,
        }
        if self.shape == Shape::Picture {
            leaf::<ByteArrayType, W>(group, &[], (&vec![1; rows], None))?;
        }
        Ok(())
    }
}

/// The schema of a table of these columns.
pub fn schema(columns: &[Column]) -> String {
    let mut text = "message schema {\n".to_owned();
    for column in columns {
        let _ = write!(text, "{}", column.schema());
    }
    text + "}"
}

/// Writes all columns of a group of so many rows.
pub fn write_group<W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    columns: &[Column],
    rows: usize,
) -> Result<()> {
    columns.iter().try_for_each(|column| column.write(group, rows))
}

fn leaf<T: DataType, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    values: &[T::T],
    (there, repeated): (&[i16], Option<&[i16]>),
) -> Result<()> {
    let mut column = group.next_column()?.expect("the schema has a column for each");
    column.typed::<T>().write_batch(values, Some(there), repeated)?;
    column.close()
}
