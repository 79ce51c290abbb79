//! A Parquet file that is written group of rows by group of rows, and a series of such files.

use crate::column::{Column, Shape, Values, schema, write_group};
use crate::error::{DatasetError, disk};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows are written when they take this much: all that is held of a table.
const GROUP_BYTES: usize = 8 << 20;

/// A file.
pub struct Table {
    path: PathBuf,
    writer: SerializedFileWriter<BufWriter<File>>,
    waiting: Vec<Column>,
    waiting_rows: usize,
}

impl Table {
    /// A table of the columns that `first` has; those of every row that comes must be the same.
    pub fn create(path: &Path, first: &[Column], facts: &[(&str, String)]) -> Result<Self, DatasetError> {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|source| disk(folder, source))?;
        }
        let file = File::create_new(path).map_err(|source| disk(path, source))?;
        let facts = facts.iter().map(|(key, value)| KeyValue::new((*key).to_owned(), value.clone())).collect();
        let mut properties = WriterProperties::builder()
            .set_created_by(format!("stillroom {}", env!("CARGO_PKG_VERSION")))
            .set_key_value_metadata(Some(facts));
        for column in first {
            let at = match (column.shape, &column.values) {
                (Shape::Picture, _) => vec![column.name.clone(), "bytes".to_owned()],
                (Shape::One, Values::Bytes(_)) => vec![column.name.clone()],
                _ => continue,
            };
            let at = ColumnPath::new(at);
            properties = properties
                .set_column_dictionary_enabled(at.clone(), false)
                .set_column_statistics_enabled(at, EnabledStatistics::None);
        }
        let failed = |source| DatasetError::Table { path: path.to_path_buf(), source };
        let schema = parse_message_type(&schema(first)).map_err(failed)?;
        let writer = SerializedFileWriter::new(BufWriter::new(file), Arc::new(schema), Arc::new(properties.build()));
        let writer = writer.map_err(failed)?;
        Ok(Self { path: path.to_path_buf(), writer, waiting: Vec::new(), waiting_rows: 0 })
    }

    /// Adds rows.
    pub fn add(&mut self, columns: Vec<Column>, rows: usize) -> Result<(), DatasetError> {
        if self.waiting.is_empty() {
            self.waiting = columns;
        } else {
            self.waiting.iter_mut().zip(columns).for_each(|(waiting, column)| waiting.append(column));
        }
        self.waiting_rows += rows;
        if bytes_of(&self.waiting) >= GROUP_BYTES { self.write() } else { Ok(()) }
    }

    /// About the size that the file has now.
    pub fn bytes(&self) -> usize {
        self.writer.bytes_written() + bytes_of(&self.waiting)
    }

    /// Writes the rest.
    pub fn finish(mut self) -> Result<(), DatasetError> {
        self.write()?;
        self.writer.close().map_err(|source| DatasetError::Table { path: self.path, source })?;
        Ok(())
    }

    fn write(&mut self) -> Result<(), DatasetError> {
        let columns = std::mem::take(&mut self.waiting);
        let rows = std::mem::take(&mut self.waiting_rows);
        if rows == 0 {
            return Ok(());
        }
        let mut write = || {
            let mut group = self.writer.next_row_group()?;
            write_group(&mut group, &columns, rows)?;
            group.close()
        };
        write().map_err(|source| DatasetError::Table { path: self.path.clone(), source })?;
        Ok(())
    }
}

/// About the bytes that rows take.
pub fn bytes_of(columns: &[Column]) -> usize {
    columns.iter().map(|column| column.values.bytes()).sum()
}

/// Files `chunk-000/file-000.parquet` and so on in a folder, each of at most a given size where an episode fits.
pub struct Series {
    folder: PathBuf,
    bytes_most: usize,
    files_each: usize,
    /// Chunk and file that are written.
    pub at: (usize, usize),
    table: Option<Table>,
}

impl Series {
    /// In this folder, so many files in a chunk.
    pub fn new(folder: PathBuf, bytes_most: usize, files_each: usize) -> Self {
        Self { folder, bytes_most, files_each, at: (0, 0), table: None }
    }

    /// Goes on to the next file if `bytes` more would be too many.
    pub fn make_room(&mut self, bytes: usize) -> Result<(), DatasetError> {
        let is_full = self.table.as_ref().is_some_and(|table| table.bytes() + bytes > self.bytes_most);
        let Some(full) = self.table.take_if(|_| is_full) else { return Ok(()) };
        full.finish()?;
        let (chunk, file) = self.at;
        self.at = if file + 1 == self.files_each { (chunk + 1, 0) } else { (chunk, file + 1) };
        Ok(())
    }

    /// Adds rows to the file that is written.
    pub fn add(&mut self, columns: Vec<Column>, rows: usize) -> Result<(), DatasetError> {
        let table = if let Some(table) = &mut self.table {
            table
        } else {
            let (chunk, file) = self.at;
            let path = self.folder.join(format!("chunk-{chunk:03}/file-{file:03}.parquet"));
            self.table.insert(Table::create(&path, &columns, &[])?)
        };
        table.add(columns, rows)
    }

    /// Writes the rest.
    pub fn finish(&mut self) -> Result<(), DatasetError> {
        self.table.take().map_or(Ok(()), Table::finish)
    }
}
