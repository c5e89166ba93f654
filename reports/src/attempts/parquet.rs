//! Writes rows as Apache Parquet, which data frame libraries open directly.

use crate::ReportError;
use femc_service::attempts::{Cell, Column, Kind};
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};
use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

/// Number of rows that are held in memory as columns.
const GROUP: usize = 1 << 16;

/// Writes `path` atomically.
pub fn write<R>(path: &Path, columns: &[Column<R>], rows: &[R]) -> Result<(), ReportError> {
    let at = ReportError::file(path);
    let unwritten = |cause| ReportError::Parquet { path: path.to_owned(), cause };
    let new = path.with_extension("parquet.new");
    let written = fs::File::create(&new)
        .map_err(&at)
        .and_then(|file| write_rows(file, columns, rows).map_err(unwritten))
        .and_then(|()| fs::rename(&new, path).map_err(&at));
    if written.is_err() {
        // A leftover file does no harm.
        let _ = fs::remove_file(&new);
    }
    written
}

fn write_rows<W: Write + Send, R>(file: W, columns: &[Column<R>], rows: &[R]) -> Result<(), ParquetError> {
    let mut writer = SerializedFileWriter::new(file, schema(columns)?, Arc::new(WriterProperties::default()))?;
    for some in rows.chunks(GROUP) {
        let mut group = writer.next_row_group()?;
        for column in columns {
            let Some(mut out) = group.next_column()? else { break };
            write_column(&mut out, column, some)?;
            out.close()?;
        }
        group.close()?;
    }
    writer.close()?;
    Ok(())
}

fn schema<R>(columns: &[Column<R>]) -> Result<TypePtr, ParquetError> {
    let field = |column: &Column<R>| {
        let (physical, logical) = match column.kind {
            Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
            Kind::Count | Kind::Bytes => (Physical::INT64, None),
            Kind::Seconds | Kind::Share | Kind::Number => (Physical::DOUBLE, None),
        };
        let field = Type::primitive_type_builder(column.name, physical).with_repetition(Repetition::OPTIONAL);
        field.with_logical_type(logical).build().map(Arc::new)
    };
    let fields = columns.iter().map(field).collect::<Result<_, _>>()?;
    Type::group_type_builder("rows").with_fields(fields).build().map(Arc::new)
}

fn write_column<R>(out: &mut SerializedColumnWriter<'_>, column: &Column<R>, rows: &[R]) -> Result<(), ParquetError> {
    let cells: Vec<Cell> = rows.iter().map(column.value).collect();
    // 0 marks a gap, which has no value.
    let levels: Vec<i16> = cells.iter().map(|cell| i16::from(*cell != Cell::Empty)).collect();
    let levels = Some(levels.as_slice());
    match column.kind {
        Kind::Text => {
            let text = |cell| if let Cell::Text(text) = cell { Some(ByteArray::from(text.into_bytes())) } else { None };
            let values: Vec<ByteArray> = cells.into_iter().filter_map(text).collect();
            out.typed::<ByteArrayType>().write_batch(&values, levels, None)?;
        }
        Kind::Count | Kind::Bytes => {
            let count = |cell| {
                if let Cell::Count(count) = cell { Some(i64::try_from(count).unwrap_or(i64::MAX)) } else { None }
            };
            let values: Vec<i64> = cells.into_iter().filter_map(count).collect();
            out.typed::<Int64Type>().write_batch(&values, levels, None)?;
        }
        Kind::Seconds | Kind::Share | Kind::Number => {
            let real = |cell| if let Cell::Real(real) = cell { Some(real) } else { None };
            let values: Vec<f64> = cells.into_iter().filter_map(real).collect();
            out.typed::<DoubleType>().write_batch(&values, levels, None)?;
        }
    }
    Ok(())
}
